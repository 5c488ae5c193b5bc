"""The judge of the diagnosis: records with hidden effects, sealed truth, scores with intervals."""

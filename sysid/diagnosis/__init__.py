"""From measurement and model to what the model lacks."""

"""What measured records can say and what they cannot: studies of single records."""

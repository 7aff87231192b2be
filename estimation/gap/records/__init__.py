"""What is known before anything is fitted: flights as records, the base model with its candidates dormant."""

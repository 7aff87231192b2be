"""Before any fit: flights as records, and the base model with the candidate effects dormant in it."""

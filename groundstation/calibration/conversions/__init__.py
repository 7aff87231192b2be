"""From counts to SI, one kind of instrument each."""

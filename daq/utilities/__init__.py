"""What every package may use: files read within bounds and written whole, errors, words, constants, options of verbs."""

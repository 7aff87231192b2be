"""The public functions behind the verbs and the Python API. Each returns one kind of answer, to be printed, drawn or saved."""

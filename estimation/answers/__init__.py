"""The public functions behind the verbs and the Python API: each gives one kind of answer, which is printed, drawn and saved."""

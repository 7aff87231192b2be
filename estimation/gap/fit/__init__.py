"""How likely the records are: residuals whitened with the noise of these very flights, and the joint fit."""

"""The likelihood of the records: noise estimated from the flights themselves, residuals whitened with it, and the joint fit."""

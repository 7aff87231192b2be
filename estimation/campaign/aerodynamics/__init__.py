"""The aerodynamics of the whole envelope from many flights, in two ways.

Pooled: each flight's estimates, with their full covariances, as curves over the conditions flown (`forms`, `mixed`, `pooled`,
`tables`). Joint: one model whose derivatives are polynomials of the conditions, fitted to all flights by maximum likelihood;
its terms are chosen by how well they predict flights held out (`terms`, `evidence`, `joint`).
"""

"""Does the model still describe the aircraft? A monitor that looks at what a short prediction gets wrong.

A predictor runs beside the flight and is drawn a little towards each scan; what it gets wrong (its innovations) is noise as long
as the model is right. They are whitened by a vector autoregression fitted to simulated flights of the very model, with a
covariance for each kind of interval between scans; a bank of further predictors, each with one effect in, says what innovations
that effect would make; and how well they go together over the last ten seconds, with the model's own uncertainty taken out, is
the statistic. Its threshold is from simulated flights as well.
Sources: Willsky and Jones, IEEE Trans. Automatic Control 21 (1976), generalized likelihood ratio; Basseville and Nikiforov,
Detection of Abrupt Changes (1993). numpy only.
"""

FALSE_ALARMS = 0.1
"""An hour of manoeuvring, that thresholds are set for: gusts three times the usual, and other simulators than that of the
thresholds, bring several times as many, still about one or below. One an hour in usual air would notice hardly more (tables in
docs/validation/live.md)."""

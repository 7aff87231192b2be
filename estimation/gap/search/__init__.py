"""Rounds of screen, full fits and acceptance, until nothing is significant.

The words of these files:

- base: the model without the effects that are still to be found; baseline: the base fitted to the training flights, with the
  noise of its residuals.
- hypothesis: one form of one effect, added to the base with unknowns of its own.
- null: the training flights simulated from the baseline with its noise and no effect; it is screened as the flights are.
- inflation: variance of a hypothesis' score on the nulls, 1 in theory and never counted as less. A gain is divided by it.
- round: a baseline, its nulls, and the screen of all hypotheses about it.
- gain: twice the log-likelihood by which a fit is better than the baseline's.
"""

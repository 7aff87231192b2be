"""The verbs of the estimation laboratory; function bodies import what they need, when it is needed."""

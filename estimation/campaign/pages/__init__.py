"""The page of a campaign and one of each flight, made from its tables alone."""

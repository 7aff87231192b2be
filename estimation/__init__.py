"""Aircraft identification: models, estimators, the gap workflow and their reports."""

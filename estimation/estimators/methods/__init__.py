"""One file for each estimator that comes with Sideslip; a file put here is found by itself (`estimators.registry`)."""

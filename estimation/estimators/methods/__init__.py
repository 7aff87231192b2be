"""One file for each estimator of Sideslip; `estimators.registry` finds new files here by itself."""

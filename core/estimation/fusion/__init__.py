"""Estimators that put all sensors together. One file per estimator, same signature: (run, config) -> Estimate."""

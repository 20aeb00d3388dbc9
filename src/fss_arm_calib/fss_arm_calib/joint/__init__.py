"""Joint estimate: one arm from all data of many sessions, with one covariance."""

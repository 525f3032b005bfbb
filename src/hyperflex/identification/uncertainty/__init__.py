"""How sure a fit is: noise, covariance, profiles, intervals, bootstrap, prediction bands."""

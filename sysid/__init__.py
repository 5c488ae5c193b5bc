"""Block-structured nonlinear system identification."""

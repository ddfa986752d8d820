"""The cases of experiments/rod_validation.py: each module computes some rows of its table."""

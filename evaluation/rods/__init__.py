"""The cases of evaluation/rods/rod_validation.py: each module computes some rows of its table."""

"""What experiments/real_plants.py is made of."""

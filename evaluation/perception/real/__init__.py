"""What evaluation/perception/real_plants.py is made of."""

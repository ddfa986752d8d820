"""Parts of hinged_plant.py: the plants and the MuJoCo model."""

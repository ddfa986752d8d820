"""Reading and writing what other programs use: point clouds and skeletons."""

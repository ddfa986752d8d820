"""Arms: reach, paths, and how hard they can shake. Each stage is a module of its own."""

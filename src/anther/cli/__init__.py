"""The command line: `anther COMMAND ...` (`main`), one module a command."""

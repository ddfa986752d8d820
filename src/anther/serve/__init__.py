"""The house's page: what the robots did today, what failed and why, plant by plant, from the history.

It reads the history and never writes but a note, with a token; it knows no arm and sends nothing to one.
"""

from anther.serve._app import make_app

__all__ = ["make_app"]

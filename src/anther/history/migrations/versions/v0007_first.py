"""The tables of the classes (`anther.history._tables`), which a new history gets at once: none before was released."""

revision, down_revision = "0007", None

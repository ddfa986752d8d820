"""History: every visit to a plant and what became of it, in a database that several programs may write at once.

`record_trial`, `record_outcome`, `record_note` write, `read_trials`, `read_outcomes` read, `merge` takes in another
history, `export` makes tables for other programs, and `starting_material` says what is believed of a plant before
it is shaken: its own last belief, else the facts; `earlier_shake` with which shake to begin. `overview` has what
pages show. `record_house`, `record_pass`, `read_stems` keep the map of a house, `begin_shift`, `run_shift`,
`read_shift` a day's work in it. All raise InputError where there is no history of Anther's, or where it cannot be read
or written.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

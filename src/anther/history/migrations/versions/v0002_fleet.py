"""Many robots: who visited, what a visit gave and taught beside it, notes, and the indexes for a million visits."""

from __future__ import annotations

import math
from typing import Any

import sqlalchemy as sa
from alembic import op

revision, down_revision = "0002", "0001"

TIME = sa.DateTime(timezone=True)
QUANTITIES = {
    "scanned_youngs": "youngs_spread",
    "damping_ratio": "damping_spread",
    "bend_over_twist": "twist_spread",
    "radius_scale": "radius_spread",
    "response_gain": "response_spread",
}
UNKNOWN = {"radius_scale": 1.0, "radius_spread": 0.05, "response_gain": 1.0, "response_spread": 0.3}
"""What a belief from before these were learned is read as."""

FILL = (
    # one robot cannot begin two visits to a plant at a time
    "UPDATE visits SET robot = 'unnamed ' || id WHERE id NOT IN (SELECT min(id) FROM visits GROUP BY plant_id, time)",
    "UPDATE visits SET taught = true WHERE material_after IS NOT NULL AND (EXISTS (SELECT 1 FROM responses r "
    "WHERE r.visit_id = visits.id AND measured_amplitude_m IS NOT NULL) "
    "OR CAST(material_after AS TEXT) <> CAST(material_before AS TEXT))",
    "UPDATE visits SET acceleration_ms2 = (SELECT avg(coalesce(measured_acceleration_ms2, "
    "39.47841760435743 * frequency_hz * frequency_hz * measured_amplitude_m, predicted_acceleration_ms2, "
    "39.47841760435743 * frequency_hz * frequency_hz * predicted_amplitude_m)) "
    "FROM responses r JOIN shakes s ON s.visit_id = r.visit_id WHERE r.visit_id = visits.id "
    "AND (visits.success OR EXISTS (SELECT 1 FROM responses m WHERE m.visit_id = visits.id "
    "AND m.measured_amplitude_m IS NOT NULL)))",
)


def upgrade() -> None:
    """Add the columns, fill them from what is there, and make the indexes."""
    op.add_column("visits", sa.Column("robot", sa.Text, nullable=False, server_default=""))
    op.add_column("visits", sa.Column("taught", sa.Boolean, nullable=False, server_default=sa.false()))
    op.add_column("visits", sa.Column("acceleration_ms2", sa.Double))
    op.add_column("plants", sa.Column("taught", TIME))
    op.add_column("plants", sa.Column("learned", sa.JSON))
    op.create_table(
        "notes",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("visit_id", sa.Integer, sa.ForeignKey("visits.id"), nullable=False),
        sa.Column("recorded", TIME, nullable=False),
        sa.Column("text", sa.Text, nullable=False),
    )
    for statement in FILL:
        op.execute(sa.text(statement))
    _sum_what_was_taught()
    for table, column in (("visits", "plant_id"), ("visits", "time"), ("outcomes", "plant_id")):
        op.drop_index(f"ix_{table}_{column}", table)
    op.create_index("ix_visits_plant", "visits", ["plant_id", "time", "robot"], unique=True)
    op.create_index("ix_visits_time", "visits", ["time", "robot", "success", "failure", "acceleration_ms2"])
    op.create_index("ix_plants_taught", "plants", ["species", "taught"])
    op.create_index("ix_outcomes_plant", "outcomes", ["plant_id", "recorded"])
    op.create_index("ix_notes_visit", "notes", ["visit_id", "recorded"])


def _sum_what_was_taught() -> None:
    connection, sums = op.get_bind(), {}
    visits = sa.table(
        "visits",
        *(sa.column(name, sa.Boolean) for name in ("success", "taught")),
        *(sa.column(name, sa.JSON) for name in ("material_before", "material_after")),
        *(sa.column("plant_id", sa.Integer), sa.column("time", TIME)),
    )
    columns = visits.c
    query = sa.select(columns.plant_id, columns.time, columns.material_before, columns.material_after)
    query = query.where(columns.success, columns.taught).order_by(columns.time)
    for plant, time, before, after in connection.execute(query):
        if before:
            total, _ = sums.setdefault(plant, ({}, None))
            _add(total, before, after)
            sums[plant] = total, time
    plants = sa.table("plants", sa.column("id"), sa.column("learned", sa.JSON), sa.column("taught", TIME))
    for plant, (total, time) in sums.items():
        connection.execute(sa.update(plants).where(plants.c.id == plant).values(learned=total, taught=time))


def _add(total: dict[str, list[float]], before: dict[str, Any], after: dict[str, Any]) -> None:
    """Add what one visit told of each ln quantity: its precision, and that times its mean."""
    for quantity, spread in QUANTITIES.items():
        (old, s), (new, t) = (_belief(UNKNOWN | values, quantity, spread) for values in (before, after))
        if s > 0 and t > 0 and 1 / t**2 >= 1.05 / s**2:
            told = 1 / t**2 - 1 / s**2, math.log(new) / t**2 - math.log(old) / s**2
            total[quantity] = [a + b for a, b in zip(total.get(quantity, [0.0, 0.0]), told, strict=True)]


def _belief(values: dict[str, Any], quantity: str, spread: str) -> tuple[float, float]:
    if quantity == "scanned_youngs":
        return values["youngs"] * values["radius_scale"] ** 4, values[spread]
    return values[quantity], values[spread]

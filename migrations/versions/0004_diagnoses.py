"""Diagnoses: held-out runs, evidence, the fitted model, names; which runs a diagnosis is of."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def added() -> list[sa.Column[Any]]:
    """Of the table that stood ready; a row without them would have what the defaults say."""
    return [
        sa.Column("name", sa.String(length=200), nullable=False, server_default=""),
        sa.Column("robot", sa.String(length=200), nullable=True),
        sa.Column("verdict", sa.String(length=40), nullable=False, server_default="none"),
        sa.Column("notes", sa.Text(), nullable=False, server_default=""),
        sa.Column("job_id", sa.String(length=16), nullable=True),
        sa.Column("simulator", sa.String(length=100), nullable=True),
        sa.Column("model", sa.JSON(), nullable=False, server_default="{}"),
        sa.Column("evidence", sa.JSON(), nullable=True),
        sa.Column("deleted_at", sa.DateTime(timezone=True), nullable=True),
    ]


def upgrade() -> None:
    with op.batch_alter_table("diagnoses") as table:
        for column in added():
            table.add_column(column)
    op.create_index(op.f("ix_diagnoses_robot"), "diagnoses", ["robot"])
    op.create_index(op.f("ix_diagnoses_created_at"), "diagnoses", ["created_at"])
    op.create_table(
        "diagnosis_runs",
        sa.Column("diagnosis_id", sa.String(length=16), nullable=False),
        sa.Column("position", sa.Integer(), nullable=False),
        sa.Column("run_id", sa.String(length=16), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("duration_s", sa.Double(), nullable=False),
        sa.Column("held_out", sa.Boolean(), nullable=False),
        sa.ForeignKeyConstraint(
            ["diagnosis_id"],
            ["diagnoses.id"],
            name=op.f("fk_diagnosis_runs_diagnosis_id_diagnoses"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("diagnosis_id", "position", name=op.f("pk_diagnosis_runs")),
    )
    op.create_index(op.f("ix_diagnosis_runs_run_id"), "diagnosis_runs", ["run_id"])


def downgrade() -> None:
    op.drop_table("diagnosis_runs")
    op.drop_index(op.f("ix_diagnoses_created_at"), table_name="diagnoses")
    op.drop_index(op.f("ix_diagnoses_robot"), table_name="diagnoses")
    with op.batch_alter_table("diagnoses") as table:
        for column in reversed(added()):
            table.drop_column(column.name)

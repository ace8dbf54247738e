"""Live runs: which runs still grow, and what those that have ended became."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("runs") as table:
        table.add_column(sa.Column("is_live", sa.Boolean(), nullable=False, server_default=sa.false()))
    op.create_table(
        "live_runs",
        sa.Column("id", sa.String(length=16), nullable=False),
        sa.Column("robot", sa.String(length=64), nullable=False),
        sa.Column("key", sa.String(length=64), nullable=False),
        sa.Column("virtual", sa.Boolean(), nullable=False),
        sa.Column("state", sa.String(length=12), nullable=False),
        sa.Column("run_id", sa.String(length=16), nullable=True),
        sa.Column("job_id", sa.String(length=16), nullable=True),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("ended_at", sa.DateTime(timezone=True), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_live_runs")),
    )
    op.create_index(op.f("ix_live_runs_robot"), "live_runs", ["robot"])
    op.create_index(op.f("ix_live_runs_state"), "live_runs", ["state"])


def downgrade() -> None:
    op.drop_table("live_runs")
    with op.batch_alter_table("runs") as table:
        table.drop_column("is_live")

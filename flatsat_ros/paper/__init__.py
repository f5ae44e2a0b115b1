"""The reproduction: every number and figure of arXiv 2308.15177 from our own runs, with verdicts."""

from typing import TYPE_CHECKING

from flatsat_ros._lazy import lazy_names

if TYPE_CHECKING:
    from flatsat_ros.paper.runs import Runs, run_all
    from flatsat_ros.paper.table import Comparison, Table
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "Comparison": "table",
            "Runs": "runs",
            "Table": "table",
            "run_all": "runs",
        },
    )

__all__ = [
    "Comparison",
    "Runs",
    "Table",
    "run_all",
]

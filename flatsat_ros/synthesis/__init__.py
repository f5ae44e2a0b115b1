"""The offline computation of certificates, in closed form and as semidefinite programs (cvxpy with Clarabel).

Nothing of it is imported while a drone flies.
"""

from typing import TYPE_CHECKING

from flatsat_ros._lazy import lazy_names

if TYPE_CHECKING:
    from flatsat_ros.synthesis.goals import rate_covering, robust_rate_covering
    from flatsat_ros.synthesis.nominal import synthesize, synthesize_paper
    from flatsat_ros.synthesis.robust_design import synthesize_paper_robust, synthesize_robust
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "rate_covering": "goals",
            "robust_rate_covering": "goals",
            "synthesize": "nominal",
            "synthesize_paper": "nominal",
            "synthesize_paper_robust": "robust_design",
            "synthesize_robust": "robust_design",
        },
    )

__all__ = [
    "rate_covering",
    "robust_rate_covering",
    "synthesize",
    "synthesize_paper",
    "synthesize_paper_robust",
    "synthesize_robust",
]

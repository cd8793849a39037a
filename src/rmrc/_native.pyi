from rmrc.qp.program import Array

class QPSolver:
    """A dual active-set solver of quadratic programs, which starts warm."""

    def __init__(
        self, size: int, rows: int = 0, equalities: int = 0, max_iter: int = 1000
    ) -> None: ...
    def solve(
        self,
        H: Array,
        g: Array,
        lb: Array,
        ub: Array,
        C: Array,
        lo: Array,
        hi: Array,
        E: Array,
        f: Array,
    ) -> tuple[Array, Array, Array, Array, int, str]: ...
    def forget(self) -> None: ...

"""The table of `results.json` for `docs/speed.md`: written between its two marks there."""

import json
from typing import Any

from timing import REPOSITORY, RESULTS

PAGE = REPOSITORY / "docs" / "speed.md"
BEGIN, END = "<!-- by bench/table.py -->\n", "<!-- to here -->\n"
NAMES = {"python": "rmrc, Python engine"}
TITLES = {
    "panda": "Panda: frame, posture; 7 dofs",
    "g1": "Unitree G1: 5 frames, com, posture; 35 dofs",
    "panda, geoms": "Panda of MuJoCo with its geoms; the same",
    "g1, geoms": "Unitree G1 with hands and geoms; the same, 43 dofs",
    "aloha, collision": "ALOHA: 2 frames, posture, 1,522 collision pairs; 16 dofs",
}
"""What the cases of `step.py` are."""


def table(step: dict[str, Any]) -> str:
    """Return the figures of the whole step as Markdown."""
    versions: dict[str, None] = {}  # in the order of the sides
    rows = [
        "| robot, tasks | side | median, µs | p99 | p99.9 | times rmrc |",
        "|---|---|---|---|---|---|",
    ]
    for row in step["rows"]:
        title = TITLES[row["case"]]
        for side, each in row["sides"].items():
            if side == "python" and row["sides"]["rmrc"]["solver"] == "python":
                continue  # the same engine once more
            words = (f"{name} {version}" for name, version in each["versions"].items())
            versions[" with ".join(words)] = None
            engine = f"{side}, {each['solver']}" if side != "python" else NAMES[side]
            times = (each[key] for key in ("median_us", "p99_us", "p99.9_us"))
            shown = " | ".join(f"{time:.1f}" for time in times)
            rows.append(f"| {title} | {engine} | {shown} | {each['times_rmrc']:.1f} |")
            title = ""
    return "\n".join(rows) + f"\n\n{step['machine']}; {', '.join(versions)}.\n"


def main() -> None:
    """Write the table of the results into its page."""
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    made = table(json.loads(RESULTS.read_text(encoding="utf-8"))["step"])
    PAGE.write_text(f"{before}{BEGIN}\n{made}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()

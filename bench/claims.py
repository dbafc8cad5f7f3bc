"""The page that puts the paper's claims beside ours, as Markdown and as HTML."""

from collections.abc import Callable
from pathlib import Path

from bench import markdown
from bench.calibration_claims import ENOUGH, calibration_claims
from bench.comparison import interval, summary, verdict
from bench.errors import UsageError
from bench.leaderboard import number
from bench.off_spec_claims import off_spec_claims
from bench.own_claims import own_claims
from bench.pages import read_notes
from bench.paper_claims import Claim, claims
from bench.pictures import data_uri, write_calibration, write_off_spec, write_summary
from bench.report import write_page
from bench.side_claims import side_claims
from bench.statistics import difference, estimate, matched, seed_values
from bench.tables import Tables

PICTURE = (
    "High-fidelity flight and crashes in training, and the deployed return, against team size; "
    "means over seeds with one standard deviation"
)
"""What the figure shows."""
OFF_SPEC = (
    "Deployed return on drones that are off their specification; means over seeds with one "
    "standard deviation"
)
"""What the figure beside these claims shows."""
FLIGHTS = (
    "Deployed return against calibration flights, by how much of the whole pool's Hybrid it is "
    "higher; 0 flights: the LF baseline; means over seeds with one standard deviation; dotted: "
    f"{100 * ENOUGH:.0f} % lower"
)
"""What the figure of the budgets shows."""

__all__ = ["Claim", "claims", "variants", "write_claims"]


def write_claims(tables: Tables, path_md: Path, notes: Path | None = None) -> None:
    """Writes claims and variants as Markdown, and as HTML beside it.

    Args:
        tables: What the sweep found.
        path_md: Where to write; the HTML gets the suffix `.html`, the figures
            `_summary.png`, `_worlds.png` and `_flights.png`.
        notes: A Markdown file to append, e.g. why a claim fails.

    Raises:
        UsageError: The notes cannot be read, or `path_md` names the HTML.
    """
    path = Path(path_md)
    if path.suffix == ".html":
        raise UsageError(f"Markdown is written to {path} and HTML beside it: name the former.")
    own = "" if notes is None else read_notes(notes).strip()
    summary_png, worlds_png, flights_png = (
        path.with_name(f"{path.stem}_{name}.png") for name in ("summary", "worlds", "flights")
    )
    drawn = (
        (PICTURE, summary_png, write_summary(tables, summary_png)),
        (OFF_SPEC, worlds_png, write_off_spec(tables, worlds_png)),
        (FLIGHTS, flights_png, write_calibration(tables, flights_png)),
    )

    def text(link: Callable[[Path], str]) -> str:
        figures = [
            [f"![{title}]({link(picture)})", f"*{title}.*"] if there else []
            for title, picture, there in drawn
        ]
        return "\n\n".join(_document(tables, own, *figures)) + "\n"

    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text(lambda picture: picture.name), encoding="utf-8")
    write_page(text(data_uri), path.with_suffix(".html"), "The paper's claims beside ours")


def _document(
    tables: Tables, notes: str, figure: list[str], worlds: list[str], flights: list[str]
) -> list[str]:
    found = [*claims(tables), *side_claims(tables)]
    overview = [(c.title, c.paper, c.ours, _word(c)) for c in found]
    parts = [
        "# The paper's claims beside ours",
        'Claims of Mednikov and Gal, "Calibrate Once, Fly Any Team" (arXiv 2609.17265). '
        "Hybrid is the one with the MLP ensemble unless said otherwise. Every number is computed "
        "from the tables of the sweep: means over training seeds, default settings, deployed in "
        "the undisturbed high-fidelity simulator unless a cell names what it was flown with; ± is "
        'one standard deviation over seeds; "significant" means that the 95 % t-interval of the '
        "difference (paired by seed, over the seeds that both have; not corrected for the number "
        "of cells) excludes 0. Initial states depend on the seed, so ± holds their "
        "differences, too, which a paired difference does not. Crashes are onsets of contact, and "
        "contacts are flags in this simulator: drones never push each other.",
        _ended(tables),
        *figure,
        markdown.table(("claim", "paper", "ours", "verdict"), overview, range(4)),
    ]
    for i, claim in enumerate(found, 1):
        if claim.holds is None and not claim.lines:
            continue  # the table above says that it was not tested
        parts += [f"## {i}. {claim.title}", f"Paper: {claim.paper}. Ours: {claim.ours}."]
        parts += _detail(claim)
    further = (
        ("On a drone that is off its specification", "paper", off_spec_claims(tables), worlds),
        ("With fewer calibration flights", "paper", calibration_claims(tables), flights),
        ("Beyond the paper", "aim", own_claims(tables), []),
    )
    for title, theirs, made, shown in further:
        if not made:
            continue
        overview = [(c.title, c.paper, c.ours, _word(c)) for c in made]
        parts += [f"## {title}", *shown]
        parts += [markdown.table(("claim", theirs, "ours", "verdict"), overview, range(4))]
        for claim in made:
            parts += [f"### {claim.title}", *_detail(claim)]
    headings, lines = variants(tables)
    parts += ["## Settings that differ from the default"]
    parts += [markdown.table(headings, lines, (0, 1)) if lines else "None was run."]
    return [*parts, notes] if notes else parts


def _word(claim: Claim) -> str:
    """The verdict."""
    if claim.holds is None:
        return "not settled" if claim.lines else "not tested"
    return "holds" if claim.holds else "**does not hold**"


def _detail(claim: Claim) -> list[str]:
    parts = [f"Counts as holding if {claim.rule}. Verdict: {_word(claim)}."]
    return [*parts, markdown.table(claim.headings, claim.lines)] if claim.lines else parts


def variants(tables: Tables) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings and lines of the table of non-default settings beside the default, by cell."""
    headings = ("cell", "method", "default", "variant", "difference", "95 % t-interval", "verdict")
    lines = []
    for cell, found in seed_values(tables.results, "reward").items():
        for entry in sorted(entry for entry in found if entry.variant):
            default = found.get(entry._replace(variant=""), {})
            if cell.deployed_effects and not default:
                continue  # made for another reality, where nothing flies by default
            # Only the seeds that both have: a row of few seeds is compared with the same few.
            other, base = matched(found[entry], default)
            apart = difference(other, base)
            lines.append(
                (
                    markdown.escape(cell.label),
                    markdown.escape(entry.label),
                    summary(estimate(base.values())),
                    summary(estimate((other or found[entry]).values())),
                    number(apart.mean, 1),
                    interval(apart),
                    verdict(apart, "better", "worse"),
                )
            )
    return headings, lines


def _ended(tables: Tables) -> str:
    counts = tables.runs["status"].value_counts().sort_index()
    ended = ", ".join(f"{n} {status}" for status, n in counts.items())
    return f"{len(tables.runs)} runs{f': {ended}' if ended else ''}."

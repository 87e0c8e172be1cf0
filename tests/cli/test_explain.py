"""`beamseg explain` on runs of the samples, and what it says to bad input."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from beamseg_batch import read_run
from beamseg_batch.cli.main import beamseg
from beamseg_batch.reasons import KINDS, REASONS

SAMPLES = Path(__file__).parents[2] / "data" / "samples"
LIGHT = ("--set", "outputs.report=false", "-q")


def processed(folder, sample, *options):
    command = ["run", str(SAMPLES / sample), "-o", str(folder), *LIGHT, *options]
    result = CliRunner().invoke(beamseg, command)
    assert result.exit_code == 0, result.output
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    return tmp_path_factory.mktemp("explained")


@pytest.fixture(scope="module")
def arena(runs):
    """Give a run of beams, with their candidates."""
    options = ("--extrinsic", "0.071,0.011,0.04", "--max-scans", "40", "--keep-candidates")
    return processed(runs / "arena", "arena.mcap", *options)


@pytest.fixture(scope="module")
def room(runs):
    """Give a run of a room without beams, with its candidates."""
    return processed(runs / "room", "empty.mcap", "--max-scans", "12", "--keep-candidates")


@pytest.fixture(scope="module")
def plain(runs):
    """Give a run without candidates."""
    return processed(runs / "plain", "arena.mcap", "--max-scans", "5", "--profile", "report")


def at(point):
    return f"--at={','.join(f'{value:.3f}' for value in point)}"


def test_explain__a_beam(ok, arena):
    beam = read_run(arena).segments[0]
    text = ok("explain", arena, at(beam.midpoint)).stdout
    assert "segment 0     0.00 m away" in text
    assert "became segment 0" in text
    assert text.splitlines()[-1].startswith("There is a beam: segment 0.")


def test_explain__a_wall(ok, room):
    columns = read_run(room).candidates
    k = columns["reason"].tolist().index("not_free")
    middle = [0.5 * (columns[f"{axis}1"][k] + columns[f"{axis}2"][k]) for axis in "xyz"]
    result = ok("explain", room, at(middle))
    last = result.stdout.splitlines()[-1]
    assert last.startswith("No beam is here. What came nearest to one is candidate ")
    assert "part of a surface" in last
    assert "at most 25% allowed" in last
    assert last.endswith("What decides: refinement.drop.")
    assert result.stderr == ""


def test_explain__json(ok, room):
    document = json.loads(ok("explain", room, "--at", "0,0,0.5", "--within", 3, "--json").stdout)
    assert document["at"] == [0.0, 0.0, 0.5]
    assert document["within"] == 3.0
    assert document["segments"] == []
    assert len(document["candidates"]) > 20
    assert {one["reason"] for one in document["candidates"]} <= set(REASONS)


def lines_by_reason(folder):
    """Numbers of lines, place by place, by the stage and the reason of their refusal."""
    table = pq.read_table(folder / "candidates.parquet").to_pydict()
    found: dict[tuple[str, str], list[int]] = {}
    for stage, reason, n_lines in zip(
        table["stage"], table["reason"], table["n_lines"], strict=True
    ):
        if stage in {"scan", "leftovers"}:
            found.setdefault((stage, reason), []).append(n_lines)
    return found


def listed(text):
    """Rows of what was seen, and what is said of those that are left out."""
    _, _, rest = text.partition("what was seen here, in time order\n")
    rows = rest.partition("\n\n")[0].splitlines()
    more = [row for row in rows if row.endswith("more; --json has them all")]
    return [row for row in rows if row not in more], more


EVERYWHERE = ("--at", "0,0,0.5", "--within", 50)


def test_explain__lines_refused_for_one_reason_are_put_together(ok, room):
    rows, _ = listed(ok("explain", room, *EVERYWHERE).stdout)
    groups = [counts for counts in lines_by_reason(room).values() if len(counts) > 1]
    assert groups
    told = [row.partition("; ")[0][18:] for row in rows if "places, all refused" in row]
    assert told == [
        f"{sum(counts)} lines at {len(counts)} places, all refused" for counts in groups
    ]


def test_explain__of_much_the_nearest_is_shown(ok, room, monkeypatch):
    found = json.loads(ok("explain", room, *EVERYWHERE, "--json").stdout)["candidates"]
    n_groups = len(lines_by_reason(room))
    others = [one for one in found if one["stage"] not in {"scan", "leftovers"}]
    refused = sorted((one["distance"], one["candidate"]) for one in others if one["fate"] != "kept")
    monkeypatch.setattr("beamseg_batch.cli.explain_command.MAX_NAMED", n_groups + 2)
    rows, more = listed(ok("explain", room, *EVERYWHERE).stdout)
    assert more == [f"  and {len(others) - 2} more; --json has them all"]
    assert len(rows) == n_groups + 2
    named = {row[18:].partition(" (")[0] for row in rows if row[18:].startswith("candidate ")}
    assert named == {f"candidate {number}" for _, number in refused[:2]}


def test_explain__negative_numbers(ok, arena):
    assert "-1.500, -0.250, 1.000 m" in ok("explain", arena, "--at", "-1.5,-.25,1").stdout


def test_explain__far_from_everything(ok, arena):
    text = ok("explain", arena, "--at", "1000,0,5").stdout
    assert "The nearest thing is " in text
    assert "no line was found here in any scan" in text


def test_explain__run_without_candidates(ok, plain):
    text = ok("explain", plain, "--at", "0,0,20").stdout
    assert "--keep-candidates" in text
    assert json.loads(ok("explain", plain, "--at", "0,0,1", "--json").stdout)["candidates"] is None


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4", "a,b,c", "nan,0,0", "inf,0,0", "1;2;3"])
def test_explain__malformed_place(call, plain, text):
    result = call("explain", plain, f"--at={text}")
    assert result.exit_code == 2
    assert result.stdout == ""
    assert "write x,y,z in metres, world frame, for example" in result.stderr


@pytest.mark.parametrize("options", [(), ("--at", "0,0,0", "--within", "-1")])
def test_explain__wrong_options(call, plain, options):
    assert call("explain", plain, *options).exit_code == 2


def test_explain__not_a_run(refused, here, call):
    assert "there is no summary.json" in refused(1, "explain", here, "--at", "0,0,0")
    assert call("explain", here / "nothing", "--at", "0,0,0").exit_code == 2


def test_explain__candidates_that_are_gone(refused, plain, here):

    shutil.copytree(plain, here / "run")
    summary = json.loads((here / "run/summary.json").read_text(encoding="utf-8"))
    summary["files"].append("candidates.parquet")
    (here / "run/summary.json").write_text(json.dumps(summary), encoding="utf-8")
    assert "cannot be read" in refused(1, "explain", "run", "--at", "0,0,0")


def test_explain__help_teaches(ok):
    text = ok("explain", "--help").stdout
    assert "beamseg explain out --at" in text
    assert "--keep-candidates" in " ".join(text.split())


# --- run --keep-candidates --------------------------------------------------------------


def test_run__says_before_the_flight_is_read_that_the_extra_is_missing(
    refused, flight, here, monkeypatch
):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setattr("beamseg_batch.pipeline.process_flight", None)
    line = refused(2, "run", flight, "-o", "out", "--keep-candidates")
    assert line.startswith("candidates.parquet needs the library pyarrow")
    assert "pip install 'beamseg-batch[parquet]'" in line
    assert list(here.iterdir()) == []


@pytest.mark.parametrize("run", ["arena", "room"])
def test_run__every_candidate_is_counted_once(run, request):
    folder = request.getfixturevalue(run)
    summary = read_run(folder).summary
    table = pq.read_table(folder / "candidates.parquet").to_pydict()
    numbers = sorted(number for number in table["candidate"] if number is not None)
    assert numbers == list(range(len(numbers)))
    assert list(summary["rejections"]) == list(KINDS)
    stages = {"lines": {"scan"}, "leftover_lines": {"leftovers"}}
    for kind in KINDS:
        counted = dict.fromkeys(summary["rejections"][kind], 0)
        prefix = "leftover_" if kind == "leftover_lines" else ""
        for stage, reason, n_lines in zip(
            table["stage"], table["reason"], table["n_lines"], strict=True
        ):
            if reason and stage in stages.get(kind, {"gathering", "pass", "end"}):
                counted[reason.removeprefix(prefix)] += n_lines if kind in stages else 1
        assert counted == summary["rejections"][kind]
    kept = [segment for segment, fate in zip(table["segment"], table["fate"], strict=True)
            if fate == "kept"]  # fmt: skip
    assert sorted(kept) == list(range(summary["counts"]["segments"]))


def test_run__kept_candidates_change_nothing_for_any_number_of_jobs(room, runs):
    options = ("empty.mcap", "--max-scans", "12")
    without = processed(runs / "without", *options)
    two = processed(runs / "two", *options, "--keep-candidates", "--jobs", "2")
    a, b, c = (read_run(folder).summary for folder in (room, without, two))
    assert a["results_sha256"] == b["results_sha256"] == c["results_sha256"]
    assert a["rejections"] == b["rejections"] == c["rejections"]
    assert (room / "candidates.parquet").read_bytes() == (two / "candidates.parquet").read_bytes()
    assert not (without / "candidates.parquet").exists()


def test_run__candidates_of_the_profile_report(ok, here):
    folder = processed(
        here / "out", "arena.mcap", "--max-scans", "10", "--profile", "report", "--keep-candidates"
    )
    table = read_run(folder).candidates
    assert set(table["stage"]) <= {"scan", "end"}
    assert (table["fate"] == "kept").sum() == len(read_run(folder).segments)

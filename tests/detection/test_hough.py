"""The iterative Hough transform against the published program, a slow twin, and itself."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamseg_batch.detection import iterative_hough
from beamseg_batch.detection.directions import hemisphere_directions
from beamseg_batch.detection.line_fit_kernels import fit_line
from beamseg_batch.errors import ConfigError, ShapeError
from tests import naive
from tests.detection import clouds

GOLDEN = Path(__file__).parents[1] / "data" / "hough_golden"
RUNS = [
    pytest.param(path.with_suffix(".csv"), run, id=f"{path.stem}-{number}")
    for path in sorted(GOLDEN.glob("*.json"))
    for number, run in enumerate(json.loads(path.read_text(encoding="utf-8"))["runs"])
]


def same_up_to_sign(one, other, tolerance):
    return min(np.abs(one - other).max(), np.abs(one + other).max()) < tolerance


# --- the published program ------------------------------------------------------------


def test_golden_folder__is_complete():
    assert len(RUNS) == 23
    assert sum(len(run.values[1]["lines"]) for run in RUNS) == 360
    assert {run.values[1]["granularity"] for run in RUNS} == {4}


@pytest.mark.parametrize(("points", "run"), RUNS)
def test_iterative_hough__gives_the_published_programs_lines(points, run):
    cloud = np.loadtxt(points, delimiter=",")
    lines = list(
        iterative_hough(
            cloud,
            dx=run["dx_option"] or None,
            granularity=run["granularity"],
            minvotes=run["minvotes"],
            nlines=run["nlines"],
        )
    )
    assert [line.votes for line in lines] == [line["hough_votes"] for line in run["lines"]]
    assert [len(line.indices) for line in lines] == [line["n_points"] for line in run["lines"]]
    for line, golden in zip(lines, run["lines"], strict=True):
        np.testing.assert_allclose(line.cell_anchor, golden["hough_a"], rtol=0, atol=1e-6)
        np.testing.assert_allclose(line.cell_direction, golden["hough_b"], rtol=0, atol=1e-6)
        np.testing.assert_allclose(line.anchor, golden["a"], rtol=0, atol=1e-4)
        assert same_up_to_sign(line.direction, np.array(golden["b"]), 1e-4)


# --- the slow twin --------------------------------------------------------------------


def assert_same_as_twin(cloud, granularity, **options):
    """Compare line by line, up to the first that a rounding error could decide.

    Returns how many lines were compared in full.
    """
    directions = hemisphere_directions(granularity)
    twins = naive.iterative_hough(cloud, directions, **options)
    lines = list(iterative_hough(cloud, granularity=granularity, **options))
    size = np.ptp(cloud, axis=0).max()
    for number, (line, twin) in enumerate(zip(lines, twins, strict=False)):
        assert line.votes == twin.votes, number
        assert np.array_equal(line.cell_direction, twin.cell_direction), number
        np.testing.assert_allclose(
            line.cell_anchor, twin.cell_anchor, rtol=1e-12, atol=1e-12 * size
        )
        if twin.fragile:
            return number
        assert line.indices.tolist() == twin.indices, number
        np.testing.assert_allclose(line.anchor, twin.anchor, rtol=1e-12, atol=1e-9 * size)
        assert same_up_to_sign(line.direction, twin.direction, 1e-7), number
    assert len(lines) == len(twins)
    return len(lines)


@pytest.mark.parametrize("granularity", [0, 1, 2, 3])
@pytest.mark.parametrize("cloud", clouds.CLOUDS)
def test_iterative_hough__agrees_with_twin(cloud, granularity):
    assert_same_as_twin(clouds.make(cloud), granularity)


@pytest.mark.parametrize("cloud", [clouds.beams, clouds.space_lattice, clouds.uniform])
def test_iterative_hough__agrees_with_twin_at_granularity_4(cloud):
    assert_same_as_twin(clouds.make(cloud), 4)


@pytest.mark.parametrize("cloud", [clouds.beams, clouds.uniform, clouds.tiny, clouds.far_away])
def test_assert_same_as_twin__does_not_stop_early(cloud):
    assert assert_same_as_twin(clouds.make(cloud), 3) >= 4


@pytest.mark.parametrize("granularity", [1, 2, 3])
@pytest.mark.parametrize("dx", [0.25, 0.5, 0.1])
def test_iterative_hough__agrees_with_twin_at_cell_edges(granularity, dx):
    assert_same_as_twin(clouds.make(clouds.cell_edges), granularity, dx=dx)


@pytest.mark.parametrize("dx", [0.02, 0.0577350269, 0.3, 1.0, 2.5])
@pytest.mark.parametrize("cloud", [clouds.beams, clouds.cross, clouds.two_copies_each])
def test_iterative_hough__agrees_with_twin_for_any_cell_width(cloud, dx):
    assert_same_as_twin(clouds.make(cloud), 2, dx=dx)


@pytest.mark.parametrize("minvotes", [2, 3, 5, 12, 30, 1000])
@pytest.mark.parametrize("nlines", [0, 1, 2, 7])
def test_iterative_hough__agrees_with_twin_on_limits(minvotes, nlines):
    cloud = clouds.make(clouds.beams)
    assert_same_as_twin(cloud, 2, dx=0.06, minvotes=minvotes, nlines=nlines)


@settings(derandomize=True, deadline=None, max_examples=60, database=None)
@given(
    cloud=st.lists(st.tuples(*3 * [st.integers(-6, 6)]), min_size=2, max_size=14),
    granularity=st.integers(0, 2),
    dx=st.sampled_from([None, 0.5, 1.0, 0.9]),
)
def test_iterative_hough__agrees_with_twin_on_integer_points(cloud, granularity, dx):
    assert_same_as_twin(np.array(cloud, dtype=np.float64), granularity, dx=dx)


@settings(derandomize=True, deadline=None, max_examples=40, database=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 70), granularity=st.integers(0, 3))
def test_iterative_hough__agrees_with_twin_on_random_points(seed, count, granularity):
    rng = np.random.default_rng(seed)
    cloud = rng.normal(size=(count, 3)) * rng.uniform(0.01, 3, 3) + rng.uniform(-5, 5, 3)
    assert_same_as_twin(cloud, granularity)


def test_iterative_hough__agrees_with_twin_on_a_dense_cloud():
    """More points than cells of a plane, so that most directions tie within a few votes."""
    cloud = np.random.default_rng(3).uniform(-1, 1, (700, 3))
    assert assert_same_as_twin(cloud, 1, dx=0.4, minvotes=12) >= 1


# --- a quirk of the published program, kept on purpose ---------------------------------


ALIASING = [
    pytest.param([[1, -2, 1], [1, 2, -1], [2, -2, 0]], 1.5, 1, 3, 2, id="three points"),
    pytest.param([[0, 3, 0], [0, -1, -3], [0, 2, 2], [0, 0, -3]], 2.0, 0, 3, 2, id="four points"),
    pytest.param([[0, 3, -2], [0, 2, 3], [0, 3, -3], [0, 1, 3]], 1.5, 1, 4, 2, id="a plane"),
]


@pytest.mark.parametrize(("cloud", "dx", "granularity", "votes", "bounded"), ALIASING)
def test_iterative_hough__keeps_the_flat_index_of_the_published_program(
    cloud, dx, granularity, votes, bounded
):
    """The program refuses no vote with ``y_i = num_x``: it checks the flat index alone.

    Such a vote falls into the first cell of the next row, (x_i + 1, 0), and wins here
    together with votes that belong there.
    """
    cloud = np.array(cloud, dtype=np.float64)
    assert most_votes_if_both_indices_were_checked(cloud, granularity, dx) == bounded
    twin = naive.iterative_hough(cloud, hemisphere_directions(granularity), dx=dx)[0]
    line = next(iterative_hough(cloud, dx=dx, granularity=granularity))
    assert line.votes == twin.votes == votes
    assert np.array_equal(line.cell_direction, twin.cell_direction)
    np.testing.assert_allclose(line.cell_anchor, twin.cell_anchor, rtol=0, atol=1e-12)
    assert line.indices.tolist() == twin.indices


def most_votes_if_both_indices_were_checked(cloud, granularity, dx):
    directions = hemisphere_directions(granularity)
    shift = (cloud.min(axis=0) + cloud.max(axis=0)) / 2
    max_x = float(np.linalg.norm(cloud.max(axis=0) - shift))
    num_x = int(np.floor(2 * max_x / dx + 0.5))
    votes = {}
    for point in cloud - shift:
        x, y = naive.plane_coordinates(point, directions)
        columns = naive.rounded_half_away((x + max_x) / dx)
        rows = naive.rounded_half_away((y + max_x) / dx)
        for j, (column, row) in enumerate(zip(columns, rows, strict=True)):
            if column < num_x and row < num_x:
                votes[column, row, j] = votes.get((column, row, j), 0) + 1
    return max(votes.values())


# --- directions -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("granularity", "count"), list(enumerate([6, 21, 81, 321, 1281, 5121, 20481]))
)
def test_hemisphere_directions__are_unit_vectors_of_half_a_sphere(granularity, count):
    directions = hemisphere_directions(granularity)
    assert directions.shape == (count, 3)
    assert directions.dtype == np.float64
    assert not directions.flags.writeable
    # The published golden ratio is single precision.
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=0, atol=2e-7)
    assert directions[:, 2].min() >= 0.0
    both = np.round(np.concatenate([directions, -directions]), 6) + 0.0
    assert len(np.unique(both, axis=0)) == 2 * count, "no two directions are the same line"


@pytest.mark.parametrize("granularity", [0, 1, 2, 3])
def test_hemisphere_directions__are_those_of_the_subdivided_icosahedron(granularity):
    directions = hemisphere_directions(granularity)
    sphere = naive.sphere_directions(granularity)
    assert len(sphere) == 2 * len(directions)
    distances = np.linalg.norm(sphere[:, None] - np.vstack([directions, -directions]), axis=2)
    assert distances.min(axis=1).max() < 1e-7
    assert distances.min(axis=0).max() < 1e-7


@pytest.mark.parametrize("granularity", [0, 1, 2, 3, 4, 5])
def test_hemisphere_directions__start_with_the_same_corners(granularity):
    assert np.array_equal(hemisphere_directions(granularity)[:6], hemisphere_directions(0))


# --- properties -----------------------------------------------------------------------


@settings(derandomize=True, deadline=None, max_examples=25, database=None)
@given(shift=st.tuples(*3 * [st.integers(-4096, 4096)]), seed=st.integers(0, 2**16))
def test_iterative_hough__moves_with_the_cloud(shift, seed):
    """Multiples of 2**-10 add without rounding, so the centred cloud is the same."""
    cloud = np.random.default_rng(seed).integers(-1024, 1025, (40, 3)) / 1024.0
    moved = cloud + np.array(shift, dtype=np.float64)
    here = list(iterative_hough(cloud, granularity=2))
    there = list(iterative_hough(moved, granularity=2))
    assert [line.votes for line in here] == [line.votes for line in there]
    for one, other in zip(here, there, strict=True):
        assert np.array_equal(one.indices, other.indices)
        assert np.array_equal(one.direction, other.direction)
        np.testing.assert_allclose(one.anchor + shift, other.anchor, rtol=0, atol=1e-11)


@settings(derandomize=True, deadline=None, max_examples=25, database=None)
@given(power=st.integers(-30, 30), seed=st.integers(0, 2**16))
def test_iterative_hough__scales_with_the_cloud(power, seed):
    """A power of two changes no mantissa, so every vote stays where it is."""
    cloud = np.random.default_rng(seed).uniform(-1, 1, (40, 3))
    scale = 2.0**power
    here = list(iterative_hough(cloud, granularity=2))
    there = list(iterative_hough(cloud * scale, granularity=2))
    assert [line.votes for line in here] == [line.votes for line in there]
    for one, other in zip(here, there, strict=True):
        assert np.array_equal(one.indices, other.indices)
        assert np.array_equal(one.direction, other.direction)
        assert np.array_equal(one.anchor * scale, other.anchor)


@settings(derandomize=True, deadline=None, max_examples=25, database=None)
@given(seed=st.integers(0, 2**16))
def test_iterative_hough__order_of_points_does_not_change_the_winning_cell(seed):
    rng = np.random.default_rng(seed)
    cloud = clouds.beams(rng)
    order = rng.permutation(len(cloud))
    here = next(iterative_hough(cloud, granularity=3))
    there = next(iterative_hough(cloud[order], granularity=3))
    assert here.votes == there.votes
    assert np.array_equal(here.cell_anchor, there.cell_anchor)
    assert np.array_equal(here.cell_direction, there.cell_direction)
    assert sorted(order[there.indices]) == here.indices.tolist()


@settings(derandomize=True, deadline=None, max_examples=30, database=None)
@given(seed=st.integers(0, 2**16), minvotes=st.integers(2, 20), granularity=st.integers(0, 4))
def test_iterative_hough__lines_share_no_point_and_have_enough(seed, minvotes, granularity):
    cloud = clouds.beams(np.random.default_rng(seed))
    dx = 0.06
    used = set()
    for line in iterative_hough(cloud, dx=dx, granularity=granularity, minvotes=minvotes):
        members = set(line.indices.tolist())
        assert len(members) == len(line.indices) >= minvotes
        assert not members & used
        used |= members
        assert np.all(np.diff(line.indices) > 0), "in the order of the cloud"
        assert line.votes <= len(cloud)
        assert abs(np.linalg.norm(line.direction) - 1.0) < 1e-12
        assert line.direction @ line.cell_direction >= 0.0
        np.testing.assert_allclose(line.anchor, cloud[line.indices].mean(axis=0), atol=1e-12)


def test_iterative_hough__granularity_reaches_the_accumulator():
    """Fault of the original: its YAML value never did, so it always searched with 4."""
    cloud = clouds.make(clouds.beams)
    for granularity in range(7):
        line = next(iterative_hough(cloud, granularity=granularity))
        directions = hemisphere_directions(granularity)
        assert (directions == line.cell_direction).all(axis=1).any()
    coarse, fine = (next(iterative_hough(cloud, granularity=g)) for g in (2, 5))
    assert not (hemisphere_directions(2) == fine.cell_direction).all(axis=1).any()
    # A finer sphere has a direction nearer to the line that is fitted in the end.
    assert coarse.cell_direction @ coarse.direction < fine.cell_direction @ fine.direction


def test_iterative_hough__searches_only_when_asked():
    cloud = clouds.make(clouds.beams)
    lines = iterative_hough(cloud, granularity=3)
    first = next(lines)
    snapshot = first.indices.copy()
    rest = list(lines)
    assert rest
    assert np.array_equal(first.indices, snapshot), "a line given away is not overwritten"
    whole = list(iterative_hough(cloud, granularity=3))
    assert [line.votes for line in whole] == [line.votes for line in (first, *rest)]


def test_iterative_hough__searches_side_by_side_do_not_disturb_each_other():
    one, two = clouds.make(clouds.beams), clouds.make(clouds.uniform)
    alone = [list(iterative_hough(cloud, granularity=2)) for cloud in (one, two)]
    mixed = list(
        itertools.zip_longest(
            iterative_hough(one, granularity=2), iterative_hough(two, granularity=2)
        )
    )
    for column, lines in enumerate(alone):
        found = [pair[column] for pair in mixed if pair[column] is not None]
        assert [line.indices.tolist() for line in found] == [
            line.indices.tolist() for line in lines
        ]


def test_iterative_hough__does_not_change_its_cloud():
    cloud = clouds.make(clouds.beams)
    before = cloud.copy()
    cloud.flags.writeable = False
    list(iterative_hough(cloud, granularity=1))
    assert np.array_equal(cloud, before)


@pytest.mark.parametrize("order", ["F", "strided"])
def test_iterative_hough__takes_any_memory_layout(order):
    cloud = clouds.make(clouds.beams)
    other = np.asfortranarray(cloud) if order == "F" else np.repeat(cloud, 2, axis=0)[::2]
    assert not other.flags.c_contiguous
    expected = [line.indices.tolist() for line in iterative_hough(cloud, granularity=1)]
    assert [line.indices.tolist() for line in iterative_hough(other, granularity=1)] == expected


@pytest.mark.parametrize(
    "cloud",
    [
        np.empty((0, 3)),
        np.array([[1.0, 2.0, 3.0]]),
        np.tile([0.1, 0.2, 0.3], (7, 1)),
    ],
)
def test_iterative_hough__cloud_without_extent_holds_no_line(cloud):
    assert list(iterative_hough(cloud)) == []
    assert list(iterative_hough(cloud, dx=0.05)) == []


def test_iterative_hough__cloud_smaller_than_a_cell_holds_no_line():
    cloud = clouds.make(clouds.two_points)
    diagonal = float(np.linalg.norm(cloud[1] - cloud[0]))
    assert list(iterative_hough(cloud, dx=diagonal)) == []
    assert len(list(iterative_hough(cloud, dx=diagonal / 64))) == 1


def test_iterative_hough__copies_of_one_point_are_no_line():
    """Their mean may differ from them by rounding, which is no extent and has no direction."""
    rng = np.random.default_rng(5)
    for count in (3, 5, 6, 7, 9, 11):
        for point in rng.uniform(0, 1, (20, 3)):
            cloud = np.concatenate(
                [np.tile(point, (count, 1)), [point + np.array([2.0, 1.0, 3.0])]]
            )
            for line in iterative_hough(cloud, granularity=1, dx=0.1):
                assert np.ptp(cloud[line.indices], axis=0).max() > 0.0


@pytest.mark.parametrize("shape", [(3,), (4, 2), (2, 3, 1)])
def test_iterative_hough__raise_on_other_shape(shape):
    with pytest.raises(ShapeError, match=r"must have shape \(N, 3\)"):
        next(iterative_hough(np.zeros(shape)))


def test_iterative_hough__raise_on_too_many_cells():
    with pytest.raises(ConfigError, match=r"along one side, limit \d+; see detection\.hough\.dx"):
        next(iterative_hough(clouds.make(clouds.uniform), dx=1e-5))


def test_iterative_hough__counts_more_votes_than_16_bits_hold():
    rng = np.random.default_rng(1)
    line = np.zeros((70_000, 3))
    line[:, 2] = rng.uniform(-1, 1, 70_000)
    cloud = np.concatenate([line, [[0.5, 0.5, 0.0], [-0.5, -0.5, 0.0]]])
    found = next(iterative_hough(cloud, dx=0.1, granularity=1))
    assert found.votes == len(found.indices) == 70_000


def test_iterative_hough__counts_more_votes_than_19_bits_hold():
    """Votes and flat index share 63 bits of a key; a large cloud must not overflow them."""
    count = 600_000
    line = np.zeros((count, 3))
    line[:, 2] = np.linspace(-1, 1, count)
    cloud = np.concatenate([line, [[0.5, 0.5, 0.0], [-0.5, -0.5, 0.0]]])
    found = next(iterative_hough(cloud, dx=0.1, granularity=1))
    assert found.votes == len(found.indices) == count


@pytest.mark.parametrize("num_x", [500, 1500, 3900])
def test_iterative_hough__is_exact_on_large_planes(num_x):
    """The more cells, the more votes lie nearer to an edge than single precision resolves."""
    rng = np.random.default_rng(num_x)
    cloud = clouds.noisy_line(rng, 25, [-1, -1, -1], [1, 1, 1], 0.4 / num_x)
    dx = float(np.linalg.norm(np.ptp(cloud, axis=0))) / num_x
    line = next(iterative_hough(cloud, dx=dx, granularity=1))
    assert (line.votes, line.cell_direction.tolist()) == twin_first_cell(
        cloud, hemisphere_directions(1), dx
    )


def twin_first_cell(cloud, directions, dx):
    """Votes and direction of the first winning cell, with a sparse accumulator."""
    shifted = cloud - (cloud.min(axis=0) + cloud.max(axis=0)) / 2
    max_x = max(np.linalg.norm(shifted.min(axis=0)), np.linalg.norm(shifted.max(axis=0)))
    num_x = int(naive.rounded_half_away(2 * max_x / dx))
    votes = {}
    for point in shifted:
        for flat in naive.voted_cells(point, directions, max_x, dx, num_x)[0].tolist():
            votes[flat] = votes.get(flat, 0) + 1
    most = max(votes.values())
    winner = min(flat for flat, count in votes.items() if count == most)
    return most, directions[winner % len(directions)].tolist()


# --- least squares --------------------------------------------------------------------


@settings(derandomize=True, deadline=None, max_examples=80, database=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 50), scale=st.integers(-6, 6))
def test_fit_line__agrees_with_lapack(seed, count, scale):
    rng = np.random.default_rng(seed)
    shape = rng.normal(size=(3, 3)) * [1.0, 0.1, 0.01]
    points = (rng.normal(size=(count, 3)) @ shape.T + rng.normal(size=3)) * 10.0**scale
    chosen = np.sort(rng.permutation(count)[: max(2, count // 2)])
    anchor, direction, eigenvalues = fit_line(points, chosen, len(chosen))
    centred = points[chosen] - points[chosen].mean(axis=0)
    values, vectors = np.linalg.eigh(centred.T @ centred)
    np.testing.assert_allclose(
        anchor, points[chosen].mean(axis=0), rtol=1e-12, atol=1e-12 * 10.0**scale
    )
    np.testing.assert_allclose(eigenvalues, values[::-1], rtol=1e-9, atol=1e-13 * values[2])
    if values[2] > 1.01 * values[1]:
        assert same_up_to_sign(direction, vectors[:, 2], 1e-9)


@pytest.mark.parametrize("axis", [*np.eye(3), np.array([1.0, 1.0, 1.0]) / np.sqrt(3)])
def test_fit_line__exact_line(axis):
    points = np.outer(np.linspace(-2, 3, 11), axis) + np.array([0.1, 0.2, 0.3])
    _, direction, eigenvalues = fit_line(points, np.arange(11), 11)
    assert same_up_to_sign(direction, axis, 1e-12)
    assert eigenvalues[1] < 1e-12 * eigenvalues[0]

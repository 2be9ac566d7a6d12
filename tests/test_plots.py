"""Figures drawn from synthetic tables: what is in them, not how it looks."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pyarrow as pa
import pytest

plots = pytest.importorskip("lierb.results.plots")
from matplotlib.image import imread  # noqa: E402

DTS = (1e-2, 1e-3, 1e-4)
T = np.linspace(0.0, 10.0, 101)


def tables(error):
    """Errors and summary of one example, with error(cspace, dt) as its history."""
    runs = [(cspace, dt, error(cspace, dt)) for cspace in ("SO3xR3", "SE3") for dt in DTS]
    errors = pa.concat_tables(
        pa.table(
            {
                "cspace": pa.array([cspace] * T.size).dictionary_encode(),
                "dt": np.full(T.size, dt),
                "t": T,
                "position_error": values,
            }
        )
        for cspace, dt, values in runs
    )
    summary = pa.table(
        {
            "cspace": [cspace for cspace, _, _ in runs],
            "dt": [dt for _, dt, _ in runs],
            "position_error_max": [values.max() for _, _, values in runs],
        }
    )
    return errors, summary


def drift(cspace, dt):
    return (1e-15 if cspace == "SE3" else 10 * dt**4) * T


def draw(error):
    return plots.error_figure(*tables(error), quantity="position", title="A joint")


def test_error_figure_has_both_cspaces_on_one_scale():
    left, right = draw(drift).axes
    assert "times" in left.get_title(loc="left")
    assert "SE" in right.get_title(loc="left")
    assert left.get_ylim() == right.get_ylim()
    assert left.get_yscale() == right.get_yscale() == "log"
    assert left.get_ylabel() == "position error [m]"
    assert left.get_xlabel() == right.get_xlabel() == "time [s]"
    assert left.get_xlim() == (0.0, 10.0)


def test_error_figure_has_a_line_for_each_step_from_coarse_to_fine():
    left, _ = draw(drift).axes
    assert len(left.lines) == len(DTS)
    last = [line.get_ydata()[-1] for line in left.lines]
    assert last == sorted(last, reverse=True)
    legend = [text.get_text() for text in left.get_legend().get_texts()]
    assert legend[0] == r"Δt = $10^{-2}$ s:  max $1.0\times10^{-6}$"
    assert len({line.get_color() for line in left.lines}) == len(DTS)


def test_error_figure_says_where_zeros_are_drawn():
    left, right = draw(lambda cspace, dt: 0.0 * T).axes
    for panel in (left, right):
        assert [text.get_text() for text in panel.texts] == [r"$10^{-18}$ or less"]
        assert panel.get_ylim()[0] < plots.LEAST
        assert panel.get_legend().get_texts()[0].get_text().endswith("max 0")


def test_error_figure_without_zeros_has_no_mark_for_them():
    left, _ = draw(lambda cspace, dt: np.full(T.size, 1e-9)).axes
    assert not left.texts


def test_error_figure_survives_a_run_that_broke_down():
    broken = np.where(T > 5.0, np.nan, 1e-6)
    left, _ = draw(lambda cspace, dt: broken).axes
    assert left.get_legend().get_texts()[0].get_text().endswith("not finite")


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_error_figure_of_few_rows_is_drawn(rows, tmp_path):
    errors, summary = tables(lambda cspace, dt: np.full(T.size, np.nan))
    few = errors.filter(pa.array(np.tile(np.arange(T.size) < rows, 2 * len(DTS))))
    figure = plots.error_figure(few, summary, quantity="position", title="A joint")
    plots.save(figure, tmp_path / "few", "png")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["png", "svg"])
def test_save_writes_the_same_bytes_each_time(tmp_path, kind):
    for name in ("one", "two"):
        plots.save(draw(drift), tmp_path / name, kind)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_a_figure_shows_itself_in_a_notebook():
    """A figure shows itself as an image, without pyplot."""
    assert draw(drift)._repr_png_().startswith(b"\x89PNG")


def test_saved_figures_show_something(tmp_path):
    figure = draw(drift)
    plots.save(figure, tmp_path / "a.png", "png")
    plots.save(figure, tmp_path / "a.svg", "svg")
    image = imread(tmp_path / "a.png")
    assert image.shape[0] > 600
    assert image.shape[1] > 1200
    assert 0.02 < np.mean(np.any(image[..., :3] < 0.9, axis=2)) < 0.5  # inked, and not all ink
    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    assert root.tag.endswith("svg")
    assert len(list(root.iter("{http://www.w3.org/2000/svg}path"))) > 2 * len(DTS)


def test_error_figure_leaves_matplotlibs_settings_alone(tmp_path):
    import matplotlib

    before = dict(matplotlib.rcParams)
    plots.save(draw(drift), tmp_path / "a.svg", "svg")
    assert dict(matplotlib.rcParams) == before

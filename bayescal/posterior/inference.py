"""The ArviZ record of a calibration. Only this module uses ArviZ, of version 0.x or 1.x.

A record is written as netCDF without ArviZ, xarray or pandas, because their import takes longer than a fit.
ArviZ reads the same content from it as from a file that ArviZ wrote.

A record is written in memory first: HDF5 ends the process on a full disk, where an ordinary write is an
error.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

Variables = Mapping[str, tuple[tuple[str, ...], np.ndarray]]
"""Name -> (dimensions after chain and draw, values)."""

SAMPLED = ("posterior", "sample_stats", "log_likelihood", "posterior_predictive", "prior", "prior_predictive")
"""Groups whose values have chain and draw as first dimensions."""


@dataclass(frozen=True)
class Record:
    """Named groups of labelled arrays.

    Attributes
    ----------
    groups : mapping
        Group name to its variables; those of `SAMPLED` groups have values of shape (chains, draws, ...).
    coords : mapping
        Dimension name to its labels.
    units : mapping
        Unit of each variable.
    attrs : mapping
        Attributes of the record.
    labels : mapping
        Additional labels of a dimension: name to the dimension and its labels.
    """

    groups: Mapping[str, Variables]
    coords: Mapping[str, Any]
    units: Mapping[str, str] = field(default_factory=dict)
    attrs: Mapping[str, str] = field(default_factory=dict)
    labels: Mapping[str, tuple[str, Any]] = field(default_factory=dict)

    def arrays(self, group: str) -> dict[str, tuple[tuple[str, ...], np.ndarray]]:
        """All variables of a group with all of their dimensions."""
        lead = ("chain", "draw") if group in SAMPLED else ()
        return {
            name: ((*lead, *dims), np.asarray(values)) for name, (dims, values) in self.groups[group].items()
        }

    def dimensions(self, group: str) -> dict[str, np.ndarray]:
        """Labels of the dimensions that a group uses."""
        out: dict[str, np.ndarray] = {}
        for dims, values in self.arrays(group).values():
            for dim, size in zip(dims, values.shape, strict=True):
                out.setdefault(dim, np.asarray(self.coords.get(dim, np.arange(size))))
        return out


def inference_data(record: Record) -> Any:
    """InferenceData (ArviZ 0.x) or DataTree (ArviZ 1.x) of a record."""
    import xarray as xr

    datasets = {}
    for group in record.groups:
        arrays = {
            name: xr.DataArray(values, dims=dims, attrs={"units": record.units.get(name, "1")})
            for name, (dims, values) in record.arrays(group).items()
        }
        coords: dict[str, Any] = dict(record.dimensions(group))
        coords |= {name: label for name, label in record.labels.items() if label[0] in coords}
        datasets[group] = xr.Dataset(arrays, coords=coords, attrs=dict(record.attrs))
    az = arviz()
    if int(az.__version__.split(".")[0]) < 1:
        return az.InferenceData(attrs=dict(record.attrs), **datasets)
    tree = xr.DataTree.from_dict(datasets)
    tree.attrs.update(record.attrs)
    return tree


def save(record: Record, path: Path) -> None:
    """Write a record as netCDF, in the layout of xarray.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    import h5netcdf

    content = io.BytesIO()
    with h5netcdf.File(content, "w") as file:
        file.attrs.update(record.attrs)
        for name in record.groups:
            group = file.create_group(name)
            group.attrs.update(record.attrs)
            dimensions = record.dimensions(name)
            group.dimensions = {dim: len(labels) for dim, labels in dimensions.items()}
            for dim, labels in dimensions.items():
                _variable(group, dim, (dim,), labels)
            further = {k: label for k, label in record.labels.items() if label[0] in dimensions}
            for label, (dim, values) in further.items():
                _variable(group, label, (dim,), np.asarray(values))
            for variable, (dims, values) in record.arrays(name).items():
                written = _variable(group, variable, dims, values)
                written.attrs["units"] = record.units.get(variable, "1")
                named = " ".join(label for label, (dim, _) in further.items() if dim in dims)
                if named:
                    written.attrs["coordinates"] = named
    path.write_bytes(content.getbuffer())


def _variable(group: Any, name: str, dims: tuple[str, ...], values: np.ndarray) -> Any:
    """Create a variable of a group; text is stored as strings of variable length."""
    if values.dtype.kind in "US":
        import h5py

        return group.create_variable(name, dims, h5py.string_dtype(), data=values.astype(object))
    return group.create_variable(name, dims, values.dtype, data=values)


def read_draws(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Draws (chains, draws) of variables of the posterior, read without ArviZ; absent names are left out."""
    import h5netcdf

    with h5netcdf.File(str(path), "r") as file:
        group = file["posterior"]
        return {name: np.asarray(group[name][...]) for name in names if name in group.variables}


def chains_figure(data: Any, kind: str, labels: Mapping[str, str]) -> Any:
    """A figure that ArviZ draws of parameters: their traces, ranks, pairs or autocorrelations.

    Parameters
    ----------
    data : InferenceData or DataTree
    kind : str
        A key of `CHAINS`.
    labels : mapping
        Variables to draw, and the text of each, with its unit.
    """
    az = arviz()
    old = int(az.__version__.split(".")[0]) < 1
    chosen = data["posterior"] if old else data["posterior"].to_dataset()
    renamed = chosen[list(labels)].rename(dict(labels))
    for name in renamed.data_vars:
        renamed[name].attrs = {}  # ArviZ 1.x adds the unit of the attributes to the label
    plot = getattr(az, CHAINS[kind][0 if old else 1])
    if old:
        axes = np.atleast_1d(plot(az.InferenceData(posterior=renamed)))
        return axes.flat[0].figure
    import xarray as xr

    drawn = plot(xr.DataTree.from_dict({"posterior": renamed}), backend="matplotlib")
    return drawn.viz["figure"].item()


CHAINS = {
    "trace": ("plot_trace", "plot_trace"),
    "rank": ("plot_rank", "plot_rank_dist"),
    "pair": ("plot_pair", "plot_pair"),
    "autocorrelation": ("plot_autocorr", "plot_autocorr"),
}
"""Plots of ArviZ: names in the lines 0.x and 1.x."""


def load(path: Path) -> Any:
    """Read an inference record by ArviZ."""
    return arviz().from_netcdf(str(path))


def arviz() -> Any:
    """ArviZ, without what 0.23 says at its first import of a day.

    It writes a date file at that import, which fails where another process writes it at the same time.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        try:
            return import_module("arviz")
        except FileNotFoundError:
            return import_module("arviz")

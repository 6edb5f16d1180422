"""The ArviZ record of a calibration: the one module that knows ArviZ, 0.x and 1.x alike."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

Variables = Mapping[str, tuple[tuple[str, ...], np.ndarray]]
"""Name -> (dimensions behind chain and draw, values)."""

SAMPLED = ("posterior", "sample_stats", "posterior_predictive")


def inference_data(
    groups: Mapping[str, Variables],
    coords: Mapping[str, Any],
    units: Mapping[str, str],
    attrs: Mapping[str, str],
) -> Any:
    """InferenceData (ArviZ 0.x) or DataTree (ArviZ 1.x) of named groups.

    Parameters
    ----------
    groups : mapping
        Group name to its variables; those of posterior, sample_stats and posterior_predictive have
        values of shape (chains, draws, ...).
    coords : mapping
        Dimension name to its labels.
    units : mapping
        Unit of each variable.
    attrs : mapping
        Attributes of the whole.
    """
    import xarray as xr

    datasets = {}
    for group, variables in groups.items():
        lead = ("chain", "draw") if group in SAMPLED else ()
        arrays = {
            name: xr.DataArray(values, dims=(*lead, *dims), attrs={"units": units.get(name, "1")})
            for name, (dims, values) in variables.items()
        }
        used = {dim for array in arrays.values() for dim in array.dims}
        labels = {dim: labels for dim, labels in coords.items() if dim in used}
        for dim in lead:
            labels[dim] = np.arange(next(iter(arrays.values())).sizes[dim]) if arrays else []
        datasets[group] = xr.Dataset(arrays, coords=labels, attrs=dict(attrs))
    az = _arviz()
    if int(az.__version__.split(".")[0]) < 1:
        return az.InferenceData(attrs=dict(attrs), **datasets)
    tree = xr.DataTree.from_dict(datasets)
    tree.attrs.update(attrs)
    return tree


def save(data: Any, path: Path) -> None:
    """Write an inference record as netCDF."""
    data.to_netcdf(str(path), engine="h5netcdf")


def load(path: Path) -> Any:
    """Read an inference record."""
    return _arviz().from_netcdf(str(path))


def _arviz() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # 0.23 announces 1.x at every import
        import arviz

    return arviz

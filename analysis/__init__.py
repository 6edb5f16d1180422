"""Studies, benchmarks, notebooks and the judge of the diagnosis: what is not installed with the package."""

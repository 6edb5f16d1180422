import pytest


@pytest.fixture(scope="package")
def cluster():
    """Two worker processes of Dask on this machine, one thread each; idle ones would take time of others."""
    import distributed

    with distributed.LocalCluster(2, threads_per_worker=1, processes=True, dashboard_address=None) as found:
        yield found

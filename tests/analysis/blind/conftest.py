import pytest


@pytest.fixture(scope="session")
def cluster():
    """Two worker processes of Dask on this machine, one thread each."""
    import distributed

    with distributed.LocalCluster(2, threads_per_worker=1, processes=True, dashboard_address=None) as found:
        yield found

"""Many sessions at once: `lightstage-processing batch`, on one machine or on a cluster of Dask."""

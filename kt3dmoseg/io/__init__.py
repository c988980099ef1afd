"""Readers and writers: the one seam where foreign conventions become the central types."""

from kt3dmoseg.io.formats import dataset_paths, load, load_dataset, save

__all__ = ["dataset_paths", "load", "load_dataset", "save"]

"""The labelling server: clips, frames and trajectories out; annotations in and out."""

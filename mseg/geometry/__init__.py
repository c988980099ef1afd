"""Two-view models of one motion: affine maps, homographies, fundamental matrices; and linear subspaces."""

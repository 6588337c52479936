"""Checks of a machine and of a cluster, for `zsdist.doctor`."""

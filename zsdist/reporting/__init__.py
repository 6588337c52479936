"""The paper's figures and tables from runs and evaluations, and films of driven episodes."""

from zsdist.common.cache_folder import prepare_matplotlib

prepare_matplotlib()  # before a module of this folder imports it

"""The paper's figures and tables from runs and evaluations, and films of driven episodes."""

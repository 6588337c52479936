"""Export of trained policies to bundles, which `zsdist.runtime` runs without torch and without the simulator."""

# Names of the package as editors and type checkers see them; __init__.py imports `load_policy` at its first use.
from zsdist.policy import load_policy as load_policy

__all__ = ["__version__", "load_policy"]
__version__: str

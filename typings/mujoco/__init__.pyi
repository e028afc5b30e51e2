# MuJoCo's wheels have no stubs for their compiled names (MjModel, MjData, ...), which pyright would
# report at each use: here every name is accepted, with an unknown type.
from _typeshed import Incomplete

def __getattr__(name: str) -> Incomplete: ...

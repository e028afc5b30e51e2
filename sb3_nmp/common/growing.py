"""`GrowingModule`: a module that remembers ever more rows, and is saved with all of them."""

from typing import Any, ClassVar

from torch import nn


class GrowingModule(nn.Module):
    """Base of modules with buffers that gain rows: loading takes over how many were saved."""

    #: names of these buffers
    growing: ClassVar[tuple[str, ...]]

    def _load_from_state_dict(  # pyright: ignore[reportIncompatibleMethodOverride]
        self,
        state_dict: dict[str, Any],
        prefix: str,
        *args: Any,  # noqa: ANN401
    ) -> None:
        """Take over the saved number of rows before PyTorch compares shapes."""
        for name in self.growing:
            saved = state_dict.get(prefix + name)
            if saved is not None:
                buffer = getattr(self, name)
                setattr(self, name, buffer.new_empty((len(saved), *buffer.shape[1:])))
        super()._load_from_state_dict(state_dict, prefix, *args)

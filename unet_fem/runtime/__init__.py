"""A deployed network beside a user: NumPy and LiteRT alone."""

from fem.lazy import exports

__getattr__, __dir__, __all__ = exports(
    __name__,
    {
        "unet_fem.runtime.surrogate": "Surrogate write_surrogate force_size",
        "fem.online.volume": "VOLUME_BAND",
    },
)

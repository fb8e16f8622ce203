"""A deployed network beside a user: NumPy and LiteRT alone."""

from fem.lazy import exports

__getattr__, __dir__, __all__ = exports(
    __name__,
    {
        "unet_fem.runtime.constitutive": "ConstitutiveSurrogate",
        "unet_fem.runtime.fallback": "Fallback",
        "unet_fem.runtime.modal": "ModalSurrogate",
        "unet_fem.runtime.opening": "open_surrogate",
        "unet_fem.runtime.surrogate": "Surrogate force_size",
        "unet_fem.runtime.surrogate_file": "read_surrogate write_surrogate",
        "fem.online.volume": "VOLUME_BAND",
    },
)

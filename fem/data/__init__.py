"""From a scene to its dataset: interactions, HDF5, ParaView."""

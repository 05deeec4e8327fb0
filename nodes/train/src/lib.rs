//! Dataset packing, training and refinement of transport solvers.

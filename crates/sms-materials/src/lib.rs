//! Material properties of objects, with intervals and sources.

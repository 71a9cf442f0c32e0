//! Rigid-body worlds: the World trait, the Rapier adapter, contact timing, the striker.

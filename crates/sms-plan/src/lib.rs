//! Optimisers and planning: Nelder-Mead, screening, multi-start, trial log.

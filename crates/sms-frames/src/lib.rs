//! Posed RGB-D recordings: readers, checks, resampling, normals and world alignment.

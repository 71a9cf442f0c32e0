//! Object masks through a sequence: from files, from geometry, from the truth of a generated scene.

//! Storage of the facts behind each object's material.

use crate::ObjectQuery;
use sms_core::{CoreError, atomic};
use std::path::Path;

/// Writes the facts that determined the materials, so that the effect of an edit can be shown without materializing again.
///
/// # Errors
/// [`CoreError::Write`].
pub fn save_queries(path: &Path, objects: &[ObjectQuery]) -> Result<(), CoreError> {
    atomic::write_json(path, &objects)
}

/// Reads the file of [`save_queries`].
///
/// # Errors
/// [`CoreError::Read`] when there is no such file; [`CoreError::Input`] when it is damaged.
pub fn load_queries(path: &Path) -> Result<Vec<ObjectQuery>, CoreError> {
    atomic::read_json(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn queries_round_trip() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("objects.json");
        let estimate = crate::Estimate {
            material: "glass".into(),
            density: Some(sms_core::Interval::new(2500.0, 2300.0, 2700.0)),
            ..Default::default()
        };
        let objects = vec![
            ObjectQuery { name: "a".into(), hull_fill: 0.3, volume_m3: 1e-3, ..Default::default() },
            ObjectQuery { name: "b".into(), estimate: Some(estimate), ..Default::default() },
        ];
        save_queries(&path, &objects).unwrap();
        assert_eq!(load_queries(&path).unwrap(), objects);
    }
}

//! Reads the example of the book's page on task files.

use sms_landing::LandingTask;

#[test]
fn the_example_can_be_read() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/landing/landing.toml");
    assert!(LandingTask::is_landing(&path));
    assert_eq!(LandingTask::read(&path).unwrap().start_w, [2.0, 0.0]);
}

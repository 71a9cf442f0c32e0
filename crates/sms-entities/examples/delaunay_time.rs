//! Times the tetrahedralisation of random points near a sphere, as scans give them.
//!
//! `cargo run --release -p sms-entities --example delaunay_time -- 20000`

use rand::RngExt;
use sms_core::Seed;
use sms_core::glamx::DVec3;

fn main() {
    let n: usize = std::env::args().nth(1).and_then(|a| a.parse().ok()).unwrap_or(20_000);
    let mut rng = Seed(1).rng();
    let points: Vec<DVec3> = (0..n)
        .map(|_| {
            let p = DVec3::new(rng.random(), rng.random(), rng.random()) * 2.0 - DVec3::ONE;
            p.normalize_or(DVec3::X) * (0.1 + 0.002 * rng.random::<f64>())
        })
        .collect();
    let began = std::time::Instant::now();
    let mesh = sms_entities::delaunay(&points);
    println!("{n} points, {} tetrahedra in {:.3} s", mesh.tetrahedra.len(), began.elapsed().as_secs_f64());
}

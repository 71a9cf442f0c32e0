//! Times the tetrahedralisation of points and prints the outcome as one line of JSON.
//!
//! `cargo bench -p sms-mesh --bench delaunay_time -- 20000 [OUT]` uses random points near a sphere, like
//! those of scans; `… -- IN.f64 [OUT]` reads raw little-endian f64, x y z. With OUT, the points are written to
//! `OUT.f64` and the tetrahedra to `OUT.u32` (raw little-endian u32, four point indices each).

use rand::RngExt;
use sms_core::Seed;
use sms_core::glamx::DVec3;
use std::io;

fn random_points(n: usize) -> Vec<DVec3> {
    let mut rng = Seed(1).rng();
    (0..n)
        .map(|_| {
            let p = DVec3::new(rng.random(), rng.random(), rng.random()) * 2.0 - DVec3::ONE;
            p.normalize_or(DVec3::X) * (0.1 + 0.002 * rng.random::<f64>())
        })
        .collect()
}

fn read_points(path: &str) -> io::Result<Vec<DVec3>> {
    let bytes = std::fs::read(path)?;
    let (numbers, _) = bytes.as_chunks::<8>();
    let numbers: Vec<f64> = numbers.iter().map(|b| f64::from_le_bytes(*b)).collect();
    Ok(numbers.chunks_exact(3).map(DVec3::from_slice).collect())
}

fn main() -> io::Result<()> {
    let mut args = std::env::args().skip(1).filter(|a| a != "--bench");
    let first = args.next().unwrap_or_else(|| "20000".into());
    let points = match first.parse() {
        Ok(n) => random_points(n),
        Err(_) => read_points(&first)?,
    };
    let mut seconds = f64::INFINITY;
    let mut mesh = sms_mesh::tetra::Tetrahedralization::default();
    for _ in 0..3 {
        let began = std::time::Instant::now();
        mesh = sms_mesh::tetra::delaunay(&points);
        seconds = seconds.min(began.elapsed().as_secs_f64());
    }
    if let Some(out) = args.next() {
        let raw: Vec<u8> = points.iter().flat_map(|p| p.to_array()).flat_map(f64::to_le_bytes).collect();
        std::fs::write(format!("{out}.f64"), raw)?;
        let raw: Vec<u8> = mesh.tetrahedra.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        std::fs::write(format!("{out}.u32"), raw)?;
    }
    println!(
        "{}",
        serde_json::json!({
            "points": points.len(),
            "tetrahedra": mesh.tetrahedra.len(),
            "duplicates": mesh.duplicates,
            "seconds": seconds,
        })
    );
    Ok(())
}

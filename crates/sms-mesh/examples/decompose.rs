//! Decomposes an OBJ file: `decompose IN.obj OUT_DIR [threshold] [max_parts] [max_vertices]` writes `OUT_DIR/000.obj` …
//! and prints one line of JSON with the seconds taken and the number of parts.

use sms_core::Mesh;
use sms_mesh::{ConvexConfig, convex_parts};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [input, output, rest @ ..] = args.as_slice() else {
        return Err("usage: decompose IN.obj OUT_DIR [threshold] [max_parts] [max_vertices]".into());
    };
    let number = |i: usize, default: f64| rest.get(i).map_or(Ok(default), |s| s.parse::<f64>());
    let config = ConvexConfig {
        threshold: number(0, 0.05)?,
        max_parts: number(1, 1000.0)? as usize,
        max_vertices: number(2, 64.0)? as usize,
        floor: 0.0,
    };
    let mesh = Mesh::read_obj(Path::new(input))?;
    let start = std::time::Instant::now();
    let parts = convex_parts(&mesh, &config);
    let seconds = start.elapsed().as_secs_f64();
    std::fs::create_dir_all(output)?;
    for (i, part) in parts.iter().enumerate() {
        part.write_obj(&Path::new(output).join(format!("{i:03}.obj")))?;
    }
    println!("{{\"seconds\": {seconds:.4}, \"parts\": {}}}", parts.len());
    Ok(())
}

//! Mass properties at 1 kg/m³ of OBJ meshes as JSON, for `benches/peers/trimesh_mass.py`; `--shapes DIR` writes
//! the shapes of the tests to a folder first.

#[path = "../tests/shapes/mod.rs"]
mod shapes;

use sms_core::{Mesh, polyhedron_mass_properties};
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1).peekable();
    let mut paths = Vec::new();
    if args.next_if_eq("--shapes").is_some() {
        let dir = PathBuf::from(args.next().ok_or("--shapes needs a folder")?);
        for (name, mesh) in shapes::shapes() {
            let path = dir.join(format!("{name}.obj"));
            mesh.write_obj(&path)?;
            paths.push(path);
        }
    }
    paths.extend(args.map(PathBuf::from));
    for path in paths {
        let m = polyhedron_mass_properties(&Mesh::read_obj(&path)?, 1.0)?;
        println!("{}", serde_json::json!({ "path": path, "properties": m }));
    }
    Ok(())
}

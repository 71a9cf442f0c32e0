//! Writes the analytic test shapes as OBJ files: `shapes OUT_DIR`.

#[path = "../tests/it/common.rs"]
mod common;

use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).ok_or("usage: shapes OUT_DIR")?;
    std::fs::create_dir_all(&folder)?;
    for (name, mesh) in [
        ("bowl", common::bowl(0.003)),
        ("mug", common::mug()),
        ("vase", common::vase(0.003)),
        ("torus", common::torus()),
        ("tray", common::open_box([0.3, 0.2, 0.03], 0.003)),
        ("open_box", common::open_box([0.2, 0.15, 0.1], 0.003)),
        ("chair", common::chair()),
        ("figure", common::figure()),
    ] {
        mesh.write_obj(&Path::new(&folder).join(format!("{name}.obj")))?;
    }
    Ok(())
}

//! Loads a surface (or makes one), and writes the distance from a vertex into a PLY file.
//!
//! `cargo run --release --example distances -- surface.obj 0 distance.ply`

use beltrami::geodesic::HeatMethod;
use beltrami::io::{self, Field, Geometry, Values};
use beltrami::{Control, Result, shape::make};

/// Without arguments: a torus, vertex 0, and nothing is written.
pub fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mesh = match arguments.first().filter(|name| name.contains('.')) {
        Some(path) => io::load(path)?.into_mesh()?,
        None => make::torus(1.0, 0.4, 60, 24)?,
    };
    let source = arguments.get(1).and_then(|text| text.parse().ok()).unwrap_or(0);
    let control = Control::default();
    let distance = HeatMethod::on_mesh(&mesh, 1.0, &control)?.distance(&[source], &control)?;
    let farthest = distance.iter().copied().filter(|d| d.is_finite()).fold(0.0, f64::max);
    println!("{} vertices, the farthest is {farthest:.4} from vertex {source}", mesh.vertex_count());
    if let Some(path) = arguments.get(2) {
        let data = vec![Field { name: "distance".into(), columns: 1, table: false, values: Values::F64(distance) }];
        io::save(path, &Geometry { dimension: mesh.dimension(), vertices: mesh.vertices().into(), faces: mesh.faces().into(), data })?;
    }
    Ok(())
}

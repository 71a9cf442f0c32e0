//! Pictures of the results: distributions as in the paper's figure, motion from above as planned and as realised, and a page
//! with all of them.

mod distribution;
mod motion;

use super::options::ENGINES;
use super::{BilliardsScene, Row};
use crate::MaterialPrior;
use distribution::distribution_svg;
use motion::motion_svg;
use sms_core::{CoreError, atomic};
use std::fmt::Write as _;
use std::path::Path;

/// Pictures side by side in the gallery, and the width of each in pixels.
const COLUMNS: usize = 6;
const WIDTH_PX: f64 = 300.0;

/// A picture with its height in pixels.
struct Picture {
    svg: String,
    height: f64,
}

/// Writes `index.html` (one page that needs no other file) and its pictures as SVG in `figures/` into a folder: for every
/// engine and material prior the distributions of rows `paper` and `ours`, and for the judge (the first engine that the scenes
/// were carried out in) the robust plan of every scene from above, planned above realised, alone and in a gallery. `text` is
/// shown above them.
///
/// # Errors
/// [`CoreError::Write`].
pub fn write_pictures(dir: &Path, scenes: &[BilliardsScene], text: &str) -> Result<(), CoreError> {
    let figures = dir.join("figures");
    let mut page = String::new();
    for material_prior in MaterialPrior::ALL {
        let of_prior: Vec<&BilliardsScene> =
            scenes.iter().filter(|s| s.material_prior == material_prior).collect();
        let engines: Vec<&str> = ENGINES
            .iter()
            .map(|e| e.key())
            .filter(|key| of_prior.iter().any(|s| s.realised.contains_key(*key)))
            .collect();
        for engine in &engines {
            for row in [Row::Ours, Row::Paper] {
                let Some(picture) = distribution_svg(&of_prior, row, engine) else { continue };
                let name = format!("distribution_{}_{engine}_{}.svg", row.as_str(), material_prior.as_str());
                atomic::write_bytes(&figures.join(&name), picture.svg.as_bytes())?;
                let _ = write!(
                    page,
                    "<h2>Row {}, {engine}, materials {}</h2><figure>{}</figure>",
                    row.as_str(),
                    material_prior.as_str(),
                    picture.svg
                );
            }
        }
        let Some(judge) = engines.first() else { continue };
        let mut shown = Vec::new();
        for s in &of_prior {
            let Some(picture) = motion_svg(s, judge, WIDTH_PX) else { continue };
            let name = format!("scene_{:02}_{judge}_{}.svg", s.number, material_prior.as_str());
            atomic::write_bytes(&figures.join(&name), picture.svg.as_bytes())?;
            shown.push(picture);
        }
        if let Some(gallery) = gallery(&shown) {
            let name = format!("gallery_{judge}_{}.svg", material_prior.as_str());
            atomic::write_bytes(&figures.join(&name), gallery.as_bytes())?;
            let _ = write!(
                page,
                "<h2>The robust plan of every scene, materials {}: planned above, realised in {judge} below</h2>\
                 <figure>{gallery}</figure>",
                material_prior.as_str()
            );
        }
    }
    let html = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>sms-experiments billiards</title>\
         <style>body{{font:15px/1.4 system-ui,sans-serif;margin:2em;max-width:1900px}}pre{{overflow-x:auto;\
         background:#f6f6f6;padding:1em;font-size:12px}}figure{{margin:0}}svg{{max-width:100%}}</style>\
         <h1>The billiards experiment</h1><pre>{}</pre>{page}</html>\n",
        escaped(text)
    );
    atomic::write_bytes(&dir.join("index.html"), html.as_bytes())
}

/// The pictures in rows; `None` without any.
fn gallery(pictures: &[Picture]) -> Option<String> {
    let columns = COLUMNS.min(pictures.len());
    let mut y = 0.0;
    let mut inner = String::new();
    for row in pictures.chunks(columns.max(1)) {
        for (k, picture) in row.iter().enumerate() {
            let nested = picture.svg.replacen(
                "<svg ",
                &format!("<svg x=\"{:.0}\" y=\"{y:.0}\" ", k as f64 * (WIDTH_PX + 10.0)),
                1,
            );
            inner.push_str(&nested);
        }
        y += row.iter().map(|p| p.height).fold(0.0, f64::max) + 10.0;
    }
    let width = columns as f64 * (WIDTH_PX + 10.0);
    (columns > 0).then(|| {
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{y:.0}\" \
             viewBox=\"0 0 {width:.0} {y:.0}\">{inner}</svg>"
        )
    })
}

/// Escapes text for HTML and SVG.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gallery_has_rows_as_high_as_their_highest_picture() {
        let picture = |height: f64| Picture { svg: "<svg a=\"b\"></svg>".into(), height };
        let heights = [100.0, 50.0, 70.0, 10.0, 10.0, 10.0, 40.0];
        let svg = gallery(&heights.map(picture)).unwrap();
        assert!(svg.contains("height=\"160\"") && svg.contains("x=\"0\" y=\"110\""), "{svg}");
        assert_eq!(svg.matches("<svg ").count(), 8);
        assert!(gallery(&[]).is_none());
        assert_eq!(escaped("a<b & c"), "a&lt;b &amp; c");
    }
}

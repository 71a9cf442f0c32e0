//! The 3-D view of the report page, as full as the page's size permits.

use crate::input::ReportInput;
use crate::view3d::{Detail, floor_value, view_data};
use serde_json::Value;

const VIEWER_HTML: &str = include_str!("../assets/viewer.html");
const LINKS: &str = include_str!("../assets/page.js");
/// The 3-D view; the last one uses the others.
const VIEWER: [&str; 4] = [
    include_str!("../assets/splats.js"),
    include_str!("../assets/camera.js"),
    include_str!("../assets/controls.js"),
    include_str!("../assets/viewer.js"),
];
const THREE: &str = include_str!("../assets/three.bundle.js");
const THREE_LICENSE: &str = include_str!("../assets/three.LICENSE");

/// Largest size of the page, bytes: what mail programs and code hosts accept and show.
const LARGEST_PAGE: usize = 6_000_000;
/// Contents of the 3-D view, from the fullest to the smallest; the page has the first that fits.
const DETAILS: [Detail; 5] = [
    Detail { splats: 60_000, texture_bytes: 1_800_000, views: 12, convex_parts: true },
    Detail { splats: 40_000, texture_bytes: 1_000_000, views: 8, convex_parts: true },
    Detail { splats: 20_000, texture_bytes: 500_000, views: 6, convex_parts: true },
    Detail { splats: 0, texture_bytes: 250_000, views: 3, convex_parts: true },
    Detail { splats: 0, texture_bytes: 100_000, views: 3, convex_parts: false },
];
/// Replaces a 3-D view that does not fit.
const NO_VIEW: &str = "<section id=\"section-view\"><h2>The scene in 3-D</h2><p class=\"hint\">The bodies of this scene are too large \
                       for a view on this page. <code>sms export</code> writes them for other viewers.</p></section>";

/// Adds the 3-D view if there is anything to show in it: as full as the page's size permits. If not even the smallest one
/// fits, a sentence takes its place.
pub(crate) fn with_viewer(page: &str, input: &ReportInput<'_>) -> String {
    let script = |s: &str| format!("<script>{s}</script>\n");
    if input.gaussians.is_none() && input.scene.is_none() {
        let parts = [("viewer", String::new()), ("scripts", script(LINKS))];
        return fill_late(page, &parts);
    }
    let three = format!("/*\n{THREE_LICENSE}*/\n{THREE}");
    let code: String = [three.as_str(), LINKS].iter().chain(&VIEWER).map(|s| script(s)).collect();
    let room = LARGEST_PAGE.saturating_sub(page.len() + VIEWER_HTML.len() + code.len() + 100);
    // `</` would end the script element.
    let text = |data: Value| data.to_string().replace("</", "<\\/");
    let floor = floor_value(input);
    let mut candidates = DETAILS.iter().map(|d| text(view_data(input, d, floor.as_ref())));
    let Some(data) = candidates.find(|data| data.len() <= room) else {
        return fill_late(page, &[("viewer", NO_VIEW.to_owned()), ("scripts", script(LINKS))]);
    };
    let data = format!("<script type=\"application/json\" id=\"data\">{data}</script>\n");
    fill_late(page, &[("viewer", VIEWER_HTML.to_owned()), ("scripts", data + &code)])
}

/// Replaces the two comments that stand for the 3-D view in the page, which are last in the template. Text of users is
/// escaped, so that it contains no comments.
fn fill_late(page: &str, parts: &[(&str, String); 2]) -> String {
    parts.iter().fold(page.to_owned(), |page, (name, text)| page.replacen(&format!("<!--{name}-->"), text, 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::write_report;
    use glamx::{DPose3, DVec3};
    use sms_core::Mesh;
    use sms_gaussians::GaussianModel;
    use sms_scene::{Body, BodyShape, Scene, example_material, floor_body};

    fn written(input: &ReportInput<'_>) -> String {
        let dir = tempfile::tempdir().unwrap();
        let page = std::fs::read_to_string(write_report(dir.path(), input).unwrap()).unwrap();
        assert!(page.len() <= LARGEST_PAGE, "{}", page.len());
        page
    }

    /// Bodies whose surfaces, and whose one convex part each, are spheres of these subdivisions.
    fn spheres(count: usize, visual: usize, part: usize) -> Scene {
        let body = |k: usize| Body {
            name: format!("ball_{k}"),
            visual: Mesh::icosphere(0.03, visual),
            shape: BodyShape::Hulls { hulls: vec![Mesh::icosphere(0.03, part)] },
            ..floor_body(0.0, example_material())
        };
        Scene {
            version: 1,
            name: "t".into(),
            gravity_w: DVec3::NEG_Z * 9.81,
            size_sigma: 0.0,
            x_world_recording: DPose3::IDENTITY,
            bodies: (0..count).map(body).collect(),
        }
    }

    #[test]
    fn many_bodies_fit_without_their_parts_or_without_the_view() {
        let data_of = |scene: &Scene| {
            let page = written(&ReportInput { scene: Some(scene), ..ReportInput::default() });
            let parts = page.split_once("id=\"data\">").and_then(|(_, rest)| rest.split_once("</script>"));
            (parts.map(|(data, _)| serde_json::from_str::<Value>(data).unwrap()), page)
        };
        let part_counts = |data: &Value| -> Vec<usize> {
            let bodies = data["bodies"].as_array().unwrap();
            bodies.iter().map(|b| b["parts"].as_array().unwrap().len()).collect()
        };
        // A sphere of five subdivisions has 20 480 triangles: 330 kB in the page.
        let (few, _) = data_of(&spheres(3, 2, 5));
        assert_eq!(part_counts(&few.unwrap()), [1; 3]);
        let (many, page) = data_of(&spheres(24, 2, 5));
        let many = many.unwrap();
        assert_eq!(part_counts(&many), [0; 24]);
        assert!(many["bodies"].as_array().unwrap().iter().all(|b| b["visual"].is_object()));
        assert!(page.contains("id=\"canvas\""));
        // The surfaces alone are too large.
        let (none, page) = data_of(&spheres(24, 5, 2));
        assert!(none.is_none() && !page.contains("id=\"canvas\"") && page.contains(NO_VIEW));
    }

    #[test]
    fn a_page_with_too_much_is_thinned() {
        let n = 200_000usize;
        let gaussians = GaussianModel {
            // Positions and colours without a pattern.
            positions_w: (0..n as u32)
                .map(|i| [0u32, 1, 2].map(|k| (i.wrapping_mul(2_654_435_761) >> (8 * k) & 255) as f32).into())
                .collect(),
            rotations_wg: vec![glamx::Quat::IDENTITY; n],
            scales: vec![glamx::Vec3::ONE; n],
            opacities: vec![0.5; n],
            colors: vec![[0.5; 3]; n],
            labels: vec![0; n],
            ..GaussianModel::default()
        };
        let settings_toml = "x".repeat(4_200_000);
        let data = |input: &ReportInput<'_>| {
            let page = written(input);
            let start = page.find("id=\"data\">").unwrap() + 10;
            let end = start + page[start..].find("</script>").unwrap();
            serde_json::from_str::<Value>(&page[start..end]).unwrap()["splats"]["count"].as_u64().unwrap()
        };
        let all = ReportInput { gaussians: Some(&gaussians), ..ReportInput::default() };
        let crowded = ReportInput { gaussians: Some(&gaussians), settings_toml, ..ReportInput::default() };
        assert!(data(&all) > 40_000 && data(&crowded) <= 40_000);
    }
}

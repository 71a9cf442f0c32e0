//! Conversions shared by Rerun recordings and live streams (feature `rerun`).

use sms_core::Camera;
use sms_core::glamx::DPose3;
use sms_gaussians::GaussianModel;

/// The result of logging.
pub(crate) type Logged = Result<(), rerun::RecordingStreamError>;

/// The application's id: the viewer keeps a layout per application.
pub(crate) const APPLICATION: &str = "sms";

/// Converts a pose to the transform of an entity and its children.
pub(crate) fn transform(x: &DPose3) -> rerun::Transform3D {
    let (t, q) = (x.translation.as_vec3(), x.rotation.as_quat());
    rerun::Transform3D::from_translation_rotation(t.to_array(), rerun::Quaternion::from_xyzw(q.to_array()))
}

/// Converts the intrinsics of a camera.
pub(crate) fn pinhole(camera: &Camera) -> rerun::Pinhole {
    let k = camera.intrinsics;
    rerun::Pinhole::from_focal_length_and_resolution(
        [k.fx as f32, k.fy as f32],
        [k.width as f32, k.height as f32],
    )
    .with_principal_point([k.cx as f32, k.cy as f32])
    .with_camera_xyz(rerun::components::ViewCoordinates::RDF)
    .with_image_plane_distance(0.1)
}

/// Converts a colour image of `size` (width, height).
pub(crate) fn color_image(pixels: Vec<u8>, size: [u32; 2]) -> rerun::Image {
    rerun::Image::from_rgb24(pixels, size)
}

/// Converts a depth image in metres; 0 means no measurement.
pub(crate) fn depth_image(metres: &[f32], size: [u32; 2]) -> rerun::DepthImage {
    let bytes: Vec<u8> = metres.iter().flat_map(|z| z.to_le_bytes()).collect();
    let format = rerun::components::ImageFormat::depth(size, rerun::ChannelDatatype::F32);
    rerun::DepthImage::new(bytes, format).with_meter(1.0)
}

/// Converts colours from 0 to 1 to bytes.
pub(crate) fn bytes_of(color: [f32; 3]) -> [u8; 3] {
    color.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8)
}

/// Gaussians as points.
#[derive(Debug, Clone, Default)]
pub(crate) struct GaussianPoints {
    positions: Vec<[f32; 3]>,
    radii: Vec<f32>,
    colors: Vec<[u8; 3]>,
    labels: Vec<u16>,
}

impl GaussianPoints {
    /// Converts the Gaussians of a model, thinned evenly to at most `most`; fewer points are larger.
    pub(crate) fn of(model: &GaussianModel, most: usize) -> Self {
        let stride = model.len().div_ceil(most.max(1)).max(1);
        let growth = (stride as f32).sqrt();
        let mut points = Self::default();
        for i in (0..model.len()).step_by(stride) {
            let (normal_w, [(_, a), (_, b)]) = model.disc(i);
            points.positions.push(model.positions_w[i].to_array());
            points.radii.push(growth * (a * b).sqrt());
            points.colors.push(bytes_of(model.mean_color(i, normal_w)));
            points.labels.push(model.labels.get(i).copied().unwrap_or(0));
        }
        points
    }

    /// Returns the number of points.
    #[cfg(test)]
    pub(crate) fn len(&self) -> usize {
        self.positions.len()
    }

    /// Converts the points for Rerun.
    pub(crate) fn archetype(self) -> rerun::Points3D {
        rerun::Points3D::new(self.positions)
            .with_radii(self.radii)
            .with_colors(self.colors.into_iter().map(|[r, g, b]| rerun::Color::from_rgb(r, g, b)))
            .with_class_ids(self.labels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::{Quat, Vec3};

    #[test]
    fn many_gaussians_are_thinned_evenly() {
        let model = GaussianModel {
            positions_w: (0..1000).map(|i| Vec3::new(i as f32, 0.0, 0.0)).collect(),
            rotations_wg: vec![Quat::IDENTITY; 1000],
            scales: vec![Vec3::new(0.002, 0.008, 0.0001); 1000],
            colors: vec![[1.0, 0.5, -1.0]; 1000],
            ..GaussianModel::default()
        };
        let all = GaussianPoints::of(&model, 1000);
        assert_eq!((all.len(), all.colors[0]), (1000, [255, 128, 0]));
        assert!((all.radii[0] - 0.004).abs() < 1e-6, "the disc's mean radius");
        let some = GaussianPoints::of(&model, 300);
        assert_eq!((some.len(), some.positions[1][0]), (250, 4.0));
        assert!((some.radii[0] - 0.008).abs() < 1e-6);
        assert_eq!(GaussianPoints::of(&GaussianModel::default(), 10).len(), 0);
    }
}

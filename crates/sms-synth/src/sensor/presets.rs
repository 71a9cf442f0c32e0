//! Presets of common RGB-D sensors.

use super::{ColorCamera, DepthCamera, PoseErrors, SensorModel};
use crate::recording::RecordingSettings;
use serde::{Deserialize, Serialize};

/// A common RGB-D sensor. Sizes, fields of view and ranges are those of its data sheet, depth registered to colour; laws of noise are
/// published ones. Figures that are called *assumed* have no published source that we know of: they are of the size that such
/// cameras show, and serve to have the effect in a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sensor {
    /// Orbbec Gemini 2, structured-light stereo: the defaults of [`RecordingSettings`], with exact poses and a still camera.
    Gemini2,
    /// Intel RealSense D435, active stereo.
    ///
    /// Depth: σ_z = z² s / (f b) (Grunnet-Jepsen, Sweetser & Woodfill, "Tuning depth cameras for best performance") with s = 0.08 px, f =
    /// 424 px (848 columns, 90°) and b = 50 mm, and steps of 1/32 px: 3.8 and 1.5 mm at 1 m. Ahn et al. 2019, "Analysis and Noise
    /// Modeling of the Intel RealSense D435 for Mobile Robots", also find growth with z². 87° × 58°, from 0.28 m (data sheet; at the largest
    /// resolution). Colour: 69° × 42°, rolling shutter. Windows of 7 pixels, edges, holes and times are assumed.
    D435,
    /// Microsoft Azure Kinect, time of flight (narrow field of view, unbinned: 640 × 576, 75° × 65°, 0.5 to 3.86 m).
    ///
    /// Noise of white walls is assumed to be 0.5 mm and 1.2 mm per metre, which is within the 17 mm that Microsoft states and Tölgyessy et
    /// al. 2021 ("Evaluation of the Azure Kinect and Its Comparison to Kinect V1 and Kinect V2") confirm; it grows as returned light
    /// falls, as shot noise does (Lange & Seitz 2001). The same authors describe its multipath and its flying pixels, whose size is
    /// here a consequence of geometry: one diffuse reflection, and spots 1.5 pixels wide. Colour: 90° × 59°. Limits of light, and
    /// times, are assumed.
    AzureKinect,
    /// Asus Xtion Pro Live, structured light by Primesense, as Kinect v1 (640 × 480, 58° × 45°).
    ///
    /// σ_z = 1.425 mm and steps of 2.85 mm at 1 m, both growing with z² (Khoshelham & Elberink 2012); windows of nine pixels.
    /// Nguyen, Izadi & Lovell 2012 ("Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking") find 1.2 mm + 1.9 mm/m²
    /// (z − 0.4 m)², which is 1.9 mm at 1 m. Measured from 0.5 to 5 m; the data sheet promises 0.8 to 3.5 m. Times are assumed.
    Xtion,
    /// A phone's lidar (iPhone 12 Pro and later): 256 × 192 depth from about 576 dots, with a confidence of 0 to 2.
    ///
    /// Colour of 4:3 with a lens of 26 mm in terms of 35-mm film: 67°. Range 5 m. Luetzenburg, Kroon & Bjørk 2021 ("Evaluation of
    /// the Apple iPhone 12 Pro LiDAR for an Application in Geosciences") find ± 1 cm on things longer than 10 cm; the noise of a dot is
    /// assumed to be half of it. Interpolation, smoothing, times, and the drift of its tracking are assumed.
    PhoneLidar,
}

impl Sensor {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Gemini2, Self::D435, Self::AzureKinect, Self::Xtion, Self::PhoneLidar];

    /// The word in files and on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Gemini2 => "gemini2",
            Self::D435 => "d435",
            Self::AzureKinect => "azure_kinect",
            Self::Xtion => "xtion",
            Self::PhoneLidar => "phone_lidar",
        }
    }

    /// Returns the sensor with this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|sensor| sensor.as_str() == name)
    }

    /// Returns width and height of the colour image, pixels, and its horizontal field of view, degrees.
    fn image(self) -> ((usize, usize), f64) {
        match self {
            Self::Gemini2 => ((1280, 800), 72.0),
            Self::D435 => ((1280, 720), 69.0),
            Self::AzureKinect => ((1280, 720), 90.0),
            Self::Xtion => ((640, 480), 58.0),
            Self::PhoneLidar => ((1920, 1440), 67.0),
        }
    }

    /// Returns the settings of a recording with this sensor.
    pub fn recording(self) -> RecordingSettings {
        let ((width, height), fov_deg) = self.image();
        let defaults = RecordingSettings::default();
        // The others write millimetres.
        let depth_unit_m = if self == Self::Gemini2 { defaults.depth_unit_m } else { 0.001 };
        let (fov_x, sensor) = (fov_deg.to_radians(), self.model());
        RecordingSettings { width, height, fov_x, depth_unit_m, sensor, ..defaults }
    }

    /// Returns the settings of a recording that is scaled to this width.
    pub fn recording_at(self, width: usize) -> RecordingSettings {
        let own = self.recording();
        RecordingSettings { width, height: own.height * width.min(1 << 20) / own.width, ..own }
    }

    /// Returns the errors of this sensor and of the poses that come with it.
    pub fn model(self) -> SensorModel {
        match self {
            Self::Gemini2 => SensorModel::default(),
            Self::D435 => SensorModel { depth: d435(), color: usb_camera(), poses: mounted() },
            Self::AzureKinect => SensorModel {
                depth: azure_kinect(),
                // The device triggers both cameras together.
                color: ColorCamera { delay_s: 0.0, ..usb_camera() },
                poses: mounted(),
            },
            Self::Xtion => SensorModel { depth: xtion(), color: usb_camera(), poses: mounted() },
            Self::PhoneLidar => SensorModel {
                depth: phone_lidar(),
                color: ColorCamera { delay_s: 0.0, offset_px: [0.5, 0.5], ..usb_camera() },
                poses: PoseErrors {
                    drift_share: 0.001,
                    drift_turn_rad: 0.3f64.to_radians(),
                    jitter_m: 0.0005,
                    jitter_rad: 0.05f64.to_radians(),
                    ..PoseErrors::default()
                },
            },
        }
    }
}

/// An indoor exposure of 8 ms, readout of 20 ms, 10 ms between streams that are not triggered together, and a pixel of
/// registration: assumed.
fn usb_camera() -> ColorCamera {
    ColorCamera {
        exposure_s: 0.008,
        gain_walk: 0.01,
        readout_s: 0.020,
        delay_s: 0.010,
        offset_px: [1.0, 0.5],
        ..ColorCamera::default()
    }
}

/// Poses of an arm or a tracker to which the camera is calibrated to 2 mm and 0.2°: assumed.
fn mounted() -> PoseErrors {
    PoseErrors {
        hand_eye_m: 0.002,
        hand_eye_rad: 0.2f64.to_radians(),
        jitter_m: 0.0003,
        jitter_rad: 0.03f64.to_radians(),
        ..PoseErrors::default()
    }
}

fn d435() -> DepthCamera {
    let (focal_px, baseline_m) = (424.0, 0.050);
    DepthCamera {
        sigma_m: 0.0,
        sigma_per_m: 0.08 / (focal_px * baseline_m),
        disparity_step_per_m: 1.0 / 32.0 / (focal_px * baseline_m),
        correlation_px: 7.0,
        edge_px: 4.0,
        baseline_m,
        missing_share: 0.02,
        missing_px: 30.0,
        // 848 columns over 87°, of which colour sees 69°.
        columns: columns_within(848.0, 87.0, 69.0),
        fov_rad: [87f64.to_radians(), 58f64.to_radians()],
        range_m: [0.28, 10.0],
        ..DepthCamera::default()
    }
}

fn azure_kinect() -> DepthCamera {
    DepthCamera {
        sigma_m: 0.0005,
        sigma_linear: 0.0012,
        light_exponent: 0.5,
        edge_px: 3.0,
        edge_dropout: 0.3,
        mixed_px: 1.5,
        multipath: 1.0,
        grazing_cos: 0.08,
        lost_light: 0.02,
        hole_share: 0.001,
        // 640 columns over 75°; colour sees 90°, the outer parts without depth.
        columns: columns_within(640.0, 75.0, 90.0),
        fov_rad: [75f64.to_radians(), 65f64.to_radians()],
        range_m: [0.5, 3.86],
        ..DepthCamera::perfect()
    }
}

fn xtion() -> DepthCamera {
    DepthCamera {
        sigma_m: 0.0,
        sigma_per_m: 0.001_425,
        correlation_px: 18.0,
        disparity_step_per_m: 0.002_85,
        edge_px: 4.0,
        baseline_m: 0.075,
        missing_share: 0.01,
        missing_px: 30.0,
        columns: 640,
        range_m: [0.5, 5.0],
        ..DepthCamera::default()
    }
}

fn phone_lidar() -> DepthCamera {
    DepthCamera {
        sigma_m: 0.005,
        light_exponent: 0.5,
        lost_light: 0.01,
        columns: 256,
        fills_image: false,
        dots: 576,
        smoothing_px: 5.0,
        has_confidence: true,
        range_m: [0.1, 5.0],
        ..DepthCamera::perfect()
    }
}

/// Returns the columns of an image of `view_deg` with the focal length of `columns` over `own_deg`.
fn columns_within(columns: f64, own_deg: f64, view_deg: f64) -> usize {
    let half = |degrees: f64| (0.5 * degrees.to_radians()).tan();
    (columns * half(view_deg) / half(own_deg)).round() as usize
}

#[cfg(test)]
mod tests {
    use super::super::DepthView;
    use super::*;
    use sms_core::{Image, Seed};

    /// Standard deviation of the depth of a white wall, in 60 recordings of a small image.
    fn sigma_of_wall(sensor: Sensor, z_m: f64) -> f64 {
        let settings = sensor.recording_at(256);
        // Steps, holes and interpolation are other settings; here the noise is measured.
        let camera = DepthCamera {
            disparity_step_per_m: 0.0,
            dots: 0,
            smoothing_px: 0.0,
            columns: 0,
            fov_rad: [0.0; 2],
            ..settings.sensor.depth
        };
        let k = settings.intrinsics();
        let (depth, cos) =
            (Image::filled(k.width, k.height, z_m as f32), Image::filled(k.width, k.height, 1.0));
        let echo = Image::filled(k.width, k.height, 0.8);
        let view = DepthView { depth: &depth, cos_incidence: &cos, echo: &echo, intrinsics: &k, guide: None };
        let measured = (0..20).flat_map(|seed| camera.measure(&view, Seed(seed)).depth.data);
        let errors: Vec<f64> = measured.filter(|z| *z > 0.0).map(|z| f64::from(z) - z_m).collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / errors.len() as f64).sqrt()
    }

    #[test]
    fn walls_have_the_noise_of_the_published_laws() {
        let square = |at_1_m: f64| move |z: f64| at_1_m * z * z;
        let laws: [(Sensor, &dyn Fn(f64) -> f64); 5] = [
            (Sensor::Gemini2, &|z| 0.0004 + 0.0012 * z * z),
            (Sensor::D435, &square(0.08 / (424.0 * 0.05))),
            (Sensor::AzureKinect, &|z| 0.0005 + 0.0012 * z),
            (Sensor::Xtion, &square(0.001_425)),
            (Sensor::PhoneLidar, &|_| 0.005),
        ];
        for (sensor, law) in laws {
            for z in [0.6, 1.0, 2.0] {
                let (found, expected) = (sigma_of_wall(sensor, z), law(z));
                assert!((found / expected - 1.0).abs() < 0.05, "{sensor:?} {z}: {found} {expected}");
            }
        }
    }

    #[test]
    fn names_are_those_of_the_files() {
        for sensor in Sensor::ALL {
            assert_eq!(serde_json::to_value(sensor).unwrap(), sensor.as_str());
            assert_eq!(Sensor::named(sensor.as_str()), Some(sensor));
            let settings = sensor.recording();
            settings.validate().unwrap();
            assert_eq!(sensor.recording_at(settings.width), settings);
        }
        assert_eq!(Sensor::named("kinect"), None);
        assert_eq!(Sensor::Gemini2.recording(), RecordingSettings::default());
    }

    #[test]
    fn registered_depth_keeps_the_focal_length() {
        // 640 pixels over 75° have a focal length of 417 pixels, as 834 over 90°.
        assert_eq!(columns_within(640.0, 75.0, 90.0), 834);
        assert_eq!(columns_within(848.0, 87.0, 87.0), 848);
    }

    #[test]
    fn values_out_of_range_are_named() {
        let mut settings = RecordingSettings::default();
        settings.sensor.color.exposure_s = f64::NAN;
        let key = |settings: &RecordingSettings| settings.validate().unwrap_err().key().map(str::to_owned);
        assert_eq!(key(&settings).as_deref(), Some("recording.sensor.color.exposure_s"));
        settings.sensor.depth.missing_share = 1.5;
        assert_eq!(key(&settings).as_deref(), Some("recording.sensor.depth.missing_share"));
    }
}

//! Gaussians for the 3-D view, quantised: 18 bytes each.

use crate::html::base64_of;
use serde_json::{Value, json};
use sms_gaussians::GaussianModel;

/// Steps of a coordinate between the smallest and the largest one: below 0.1 mm in a room of 5 m.
const STEPS: f32 = 65535.0;

/// Returns at most `limit` Gaussians as data of the page; `None` without any. If there are more, they are thinned evenly
/// and the rest are enlarged to cover the same area.
pub(crate) fn splats_value(model: &GaussianModel, limit: usize) -> Option<Value> {
    if model.is_empty() || limit == 0 {
        return None;
    }
    let stride = model.len().div_ceil(limit);
    let chosen: Vec<usize> = (0..model.len()).step_by(stride).collect();
    let enlarged = (stride as f32).sqrt().ln();
    let log_scale = |i: usize| model.scales[i].to_array().map(|s| s.max(1e-7).ln() + enlarged);
    let (mut low, mut high) = ([f32::MAX; 3], [f32::MIN; 3]);
    let (mut thin, mut wide) = (f32::MAX, f32::MIN);
    for &i in &chosen {
        for (k, v) in model.positions_w[i].to_array().into_iter().enumerate() {
            (low[k], high[k]) = (low[k].min(v), high[k].max(v));
        }
        for v in log_scale(i) {
            (thin, wide) = (thin.min(v), wide.max(v));
        }
    }
    let byte = |v: f32| (255.0 * v.clamp(0.0, 1.0)).round() as u8;
    let mut names: Vec<u16> = chosen.iter().map(|&i| model.labels[i]).collect();
    names.sort_unstable();
    names.dedup();
    // The palette is addressed by one byte.
    names.truncate(256);
    let (mut positions, mut rest) = (Vec::new(), Vec::new());
    for &i in &chosen {
        for (k, v) in model.positions_w[i].to_array().into_iter().enumerate() {
            let step = (v - low[k]) / (high[k] - low[k]).max(1e-9) * STEPS;
            positions.extend((step.round() as u16).to_le_bytes());
        }
        rest.extend(model.rotations_wg[i].to_array().map(|v| (127.0 * v).round() as i8 as u8));
        rest.extend(log_scale(i).map(|v| byte((v - thin) / (wide - thin).max(1e-9))));
        rest.push(byte(model.opacities[i]));
        rest.extend(model.mean_color(i, model.disc(i).0).map(byte));
        rest.push(names.binary_search(&model.labels[i]).unwrap_or(0) as u8);
    }
    let palette: Vec<[u8; 3]> = names.iter().map(|&n| sms_masks::label_color(n)).collect();
    Some(json!({
        "count": chosen.len(),
        "low": low,
        "high": high,
        "log_scale": [thin, wide],
        "pos": base64_of(&positions),
        "rest": base64_of(&rest),
        "palette": palette,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use base64::Engine;
    use sms_gaussians::Classifier;

    fn model(n: usize) -> GaussianModel {
        let at = |i: usize| i as f32 / n as f32;
        GaussianModel {
            positions_w: (0..n).map(|i| [at(i), 2.0 * at(i) - 1.0, 0.0].into()).collect(),
            rotations_wg: vec![glamx::Quat::IDENTITY; n],
            scales: (0..n).map(|i| [0.001, 0.002, 0.004 + at(i)].into()).collect(),
            opacities: vec![0.5; n],
            colors: vec![[1.0, 0.0, 0.5]; n],
            affinities: vec![[0.0; 16]; n],
            labels: (0..n).map(|i| [0, 7][i % 2]).collect(),
            label_confidence: vec![1.0; n],
            classifier: Classifier::default(),
            ..GaussianModel::default()
        }
    }

    #[test]
    fn positions_and_colours_survive_the_quantisation() {
        let model = model(100);
        let value = splats_value(&model, 1000).unwrap();
        assert_eq!(value["count"], 100);
        let decode = |key: &str| {
            base64::engine::general_purpose::STANDARD.decode(value[key].as_str().unwrap()).unwrap()
        };
        let (positions, rest) = (decode("pos"), decode("rest"));
        assert_eq!((positions.len(), rest.len()), (600, 1200));
        let number = |v: &Value| v.as_f64().unwrap() as f32;
        for (i, bytes) in positions.chunks_exact(6).enumerate() {
            for k in 0..3 {
                let step = f32::from(u16::from_le_bytes([bytes[2 * k], bytes[2 * k + 1]])) / 65535.0;
                let (low, high) = (number(&value["low"][k]), number(&value["high"][k]));
                let error = low + step * (high - low) - model.positions_w[i].to_array()[k];
                assert!(error.abs() < 1e-4, "{i}, {k}: {error}");
            }
        }
        assert_eq!(&rest[..12], [0, 0, 0, 127, 0, rest[5], rest[6], 128, 255, 0, 128, 0]);
        assert_eq!(value["palette"].as_array().unwrap().len(), 2);
    }

    #[test]
    fn a_large_model_is_thinned_and_enlarged() {
        let (all, tenth) = (splats_value(&model(100), 100).unwrap(), splats_value(&model(100), 10).unwrap());
        assert_eq!(tenth["count"], 10);
        let thin = |v: &Value| v["log_scale"][0].as_f64().unwrap();
        assert!((thin(&tenth) - thin(&all) - 10f64.sqrt().ln()).abs() < 1e-5);
        assert!(
            splats_value(&GaussianModel::default(), 10).is_none() && splats_value(&model(3), 0).is_none()
        );
    }
}

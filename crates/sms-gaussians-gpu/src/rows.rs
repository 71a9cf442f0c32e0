//! Layout of a Gaussian's parameters in the kernels: vectors of four, so that no group of parameters straddles two. In order:
//! position and logit of the opacity; rotation; logarithms of the scales; colour; affinity (four); view-dependent colour (six).

use sms_gaussians::harmonics::BASIS;
use sms_gaussians::parameters::{
    AFFINITY, COLOR, HARMONICS, LOG_SCALE, LOGIT_OPACITY, PARAMETERS, POSITION, ROTATION, ROW, Row,
};

/// First index of the view-dependent colour.
const DIRECTED: usize = 32;
/// Length of a row on the device.
pub(crate) const DEVICE_ROW: usize = DIRECTED + 3 * BASIS;
/// The same in vectors.
pub(crate) const ROW_VECTORS: u32 = DEVICE_ROW as u32 / 4;

/// Position of each parameter of a [`Row`] on the device.
const PLACES: [usize; PARAMETERS] = {
    let mut places = [0; PARAMETERS];
    let mut i = 0;
    while i < PARAMETERS {
        places[i] = match i {
            _ if i < ROTATION => i - POSITION,
            _ if i < LOG_SCALE => 4 + i - ROTATION,
            _ if i < LOGIT_OPACITY => 8 + i - LOG_SCALE,
            LOGIT_OPACITY => 3,
            _ if i < AFFINITY => 12 + i - COLOR,
            _ if i < HARMONICS => 16 + i - AFFINITY,
            _ => DIRECTED + i - HARMONICS,
        };
        i += 1;
    }
    places
};

/// Converts the host's order to the device's.
pub(crate) fn to_device(Row(row): &Row) -> [f32; DEVICE_ROW] {
    let mut to = [0.0; DEVICE_ROW];
    for (place, value) in PLACES.into_iter().zip(row) {
        to[place] = *value;
    }
    to
}

/// Converts the device's order to the host's.
pub(crate) fn to_host(row: &[f32; DEVICE_ROW]) -> Row {
    let mut to = [0.0; ROW];
    for (value, place) in to.iter_mut().zip(PLACES) {
        *value = row[place];
    }
    Row(to)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_come_back_as_they_went() {
        let mut row = [0.0; ROW];
        (0..PARAMETERS).for_each(|i| row[i] = i as f32 + 1.0);
        let there = to_device(&Row(row));
        assert_eq!(to_host(&there), Row(row));
        assert_eq!((there[3], there[4], there[8]), (11.0, 4.0, 8.0));
    }
}

//! Labels of objects that were joined.

use sms_core::Labels;

/// Relabels the pixels of joined pieces with the label of their host, in the order of joining.
pub(crate) fn relabel(labels: &mut Labels, joined: &[(u16, u16)]) {
    for map in &mut labels.maps {
        for label in &mut map.data {
            *label = host_of(*label, joined);
        }
    }
}

/// Returns the label of an object after pieces were joined one after the other.
pub(crate) fn host_of(label: u16, joined: &[(u16, u16)]) -> u16 {
    joined.iter().fold(label, |l, &(piece, host)| if l == piece { host } else { l })
}

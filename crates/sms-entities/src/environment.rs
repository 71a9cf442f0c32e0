//! The static environment: everything that no label explains.

use crate::config::EntitiesConfig;
use crate::support::Rest;
use crate::views::Views;
use sms_core::Entity;

/// The static environment; `None` where nothing but the support plane was seen.
pub(crate) fn environment_entity(
    _views: &Views,
    _objects: &[Entity],
    _rests: &[Rest],
    _support_height: Option<f64>,
    _config: &EntitiesConfig,
) -> Option<Entity> {
    None
}

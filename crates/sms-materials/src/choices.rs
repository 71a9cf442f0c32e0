//! The material class of each object, and its origin.

use crate::assign::known_of_estimate;
use crate::{Estimate, MaterialTable, ObjectQuery, Overrides, without_override};

/// Origin of the material class of an object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ClassOrigin {
    /// The user's values.
    User,
    /// The estimate of a vision-language model.
    Vlm,
    /// Words of its name or description in the table.
    Words,
    /// Nothing is known: the class is "unknown", and the values are those of the prior.
    Unknown,
}

/// The material class of an object.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClassChoice {
    /// Name of the object.
    pub name: String,
    /// Its class.
    pub class: String,
    /// Origin of the class.
    pub origin: ClassOrigin,
}

/// Returns the class that [`assign`](crate::assign) gives to each object, with its origin.
pub fn class_choices(
    objects: &[ObjectQuery],
    table: &MaterialTable,
    overrides: Option<&Overrides>,
) -> Vec<ClassChoice> {
    let choice = |object: &ObjectQuery| {
        let name = object.name.clone();
        let given = overrides.and_then(|o| o.object.get(&name)).and_then(|o| o.class.clone());
        if let Some(class) = given {
            return ClassChoice { name, class, origin: ClassOrigin::User };
        }
        let class = without_override(object, table).class;
        let of_model = |e: &Estimate| known_of_estimate(e, table).is_some() || e.class().is_some();
        let origin = match &object.estimate {
            Some(estimate) if of_model(estimate) => ClassOrigin::Vlm,
            _ if class == table.prior(object.is_sphere).class => ClassOrigin::Unknown,
            _ => ClassOrigin::Words,
        };
        ClassChoice { name, class, origin }
    };
    objects.iter().map(choice).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assign;
    use sms_core::Warnings;

    #[test]
    fn each_class_has_its_origin() {
        let query = |name: &str, description: &str, material: Option<&str>| ObjectQuery {
            name: name.into(),
            description: description.into(),
            volume_m3: 1e-3,
            estimate: material.map(|m| Estimate { material: m.into(), ..Estimate::default() }),
            ..ObjectQuery::default()
        };
        let objects = [
            query("mug", "", None),
            query("object_02", "rubber duck", None),
            query("object_03", "", None),
            query("object_04", "", Some("steel")),
            // The table does not have this material.
            query("object_05", "", Some("moon rock")),
            // The model did not recognise it.
            query("steel_can", "", Some("")),
            query("cup", "", Some("glass")),
            query("object_08", "", None),
        ];
        let mut overrides = Overrides::default();
        overrides.set("cup", "class", "brass").unwrap();
        overrides.set("object_08", "friction", "0.4").unwrap();
        let table = MaterialTable::builtin();
        let choices = class_choices(&objects, &table, Some(&overrides));
        use ClassOrigin::{Unknown, User, Vlm, Words};
        let origins: Vec<ClassOrigin> = choices.iter().map(|c| c.origin).collect();
        assert_eq!(origins, [Words, Words, Unknown, Vlm, Vlm, Words, User, Unknown]);
        // The classes are those of the scene.
        let materials = assign(&objects, &table, Some(&overrides), &Warnings::new()).unwrap();
        for ((choice, object), material) in choices.iter().zip(&objects).zip(&materials) {
            assert_eq!((&choice.name, &choice.class), (&object.name, &material.class));
        }
    }
}

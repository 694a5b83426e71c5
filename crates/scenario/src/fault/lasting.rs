//! What all faults that last have in common, and how their tables are made.

/// What all faults that last have in common.
pub trait Lasting {
    /// Begins.
    fn start_seconds(&self) -> f64;
    /// Ends; never without.
    fn end_seconds(&self) -> Option<f64>;

    /// Whether it acts at a scenario time.
    fn acts_at(&self, time_seconds: f64) -> bool {
        time_seconds >= self.start_seconds()
            && self.end_seconds().is_none_or(|end| time_seconds < end)
    }
}

/// Whether one of these faults acts at a scenario time.
#[must_use]
pub fn any_acts(faults: &[impl Lasting], time_seconds: f64) -> bool {
    faults.iter().any(|fault| fault.acts_at(time_seconds))
}

/// Makes the table of a group of faults from its kinds: the group with an array for each, the kinds that last with
/// `from_seconds` and `until_seconds`.
macro_rules! faults {
    (
        $(#[$group_meta:meta])*
        $group:ident {
            $($(#[$kind_meta:meta])* $kind:ident: $fault:ident {
                $($(#[$field_meta:meta])* $field:ident: $type:ty,)*
            })*
        }
        $(plus { $($(#[$other_meta:meta])* $other:ident: $other_type:ident,)* })?
    ) => {
        $(#[$group_meta])*
        #[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct $group {
            $(
                $(#[$kind_meta])*
                #[schemars(length(max = 100))]
                #[serde(skip_serializing_if = "Vec::is_empty")]
                pub $kind: Vec<$fault>,
            )*
            $($(
                $(#[$other_meta])*
                #[schemars(length(max = 100))]
                #[serde(skip_serializing_if = "Vec::is_empty")]
                pub $other: Vec<$other_type>,
            )*)?
        }

        impl $group {
            /// True without any fault.
            #[must_use]
            pub fn is_empty(&self) -> bool {
                $(self.$kind.is_empty() &&)* $($(self.$other.is_empty() &&)*)? true
            }
        }

        $(
            $(#[$kind_meta])*
            #[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
            #[serde(deny_unknown_fields)]
            pub struct $fault {
                /// When the fault begins.
                #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
                pub from_seconds: f64,
                /// When the fault ends; with the run if absent.
                #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
                #[serde(default, skip_serializing_if = "Option::is_none")]
                pub until_seconds: Option<f64>,
                $($(#[$field_meta])* pub $field: $type,)*
            }

            impl $crate::fault::lasting::Lasting for $fault {
                fn start_seconds(&self) -> f64 {
                    self.from_seconds
                }

                fn end_seconds(&self) -> Option<f64> {
                    self.until_seconds
                }
            }
        )*
    };
}
pub(super) use faults;

/// 1 as a default: always, or one frame.
pub(super) fn one() -> f64 {
    1.0
}

//! The nearest integer, as `libm::round` has it, in fewer steps: where a number becomes an object's integer, the cast does
//! the cutting.

/// The largest number below a half: a half itself would take the number below it over the edge.
const HALF: f64 = 0.5 - f64::EPSILON / 4.0;

/// What a cast to an integer, which cuts, makes the nearest one; halves go away from zero.
#[must_use]
#[inline]
pub fn to_be_cut(value: f64) -> f64 {
    value + HALF.copysign(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[expect(clippy::cast_possible_truncation, reason = "this is what is tested")]
    fn both_ways(value: f64) -> [i32; 2] {
        [to_be_cut(value) as i32, libm::round(value) as i32]
    }

    #[test]
    fn edges_are_rounded_as_libm_does() {
        let below_half = f64::from_bits(0.5_f64.to_bits() - 1);
        let values = [below_half, 0.5, 1.5, 2.5, 1e300, f64::INFINITY, f64::NAN];
        for value in values {
            for [cut, rounded] in [both_ways(value), both_ways(-value)] {
                assert_eq!(cut, rounded, "{value}");
            }
        }
    }

    proptest! {
        #[test]
        fn anything_is_rounded_as_libm_does(value in -1e10..1e10_f64, any in any::<f64>()) {
            for [cut, rounded] in [both_ways(value), both_ways(any)] {
                prop_assert_eq!(cut, rounded);
            }
        }
    }
}

//! Natural order of names: `2` before `10`.

use std::cmp::Ordering;

/// Compares two names, runs of digits by their value and everything else byte by byte.
///
/// Names that differ only in leading zeros are ordered by the plain comparison, so the order is total.
pub fn cmp(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a.as_bytes(), b.as_bytes());
    while let (Some(x), Some(y)) = (left.first(), right.first()) {
        let order = if x.is_ascii_digit() && y.is_ascii_digit() {
            let (digits_left, digits_right) = (digits(&mut left), digits(&mut right));
            digits_left.len().cmp(&digits_right.len()).then_with(|| digits_left.cmp(digits_right))
        } else {
            (left, right) = (&left[1..], &right[1..]);
            x.cmp(y)
        };
        if order.is_ne() {
            return order;
        }
    }
    left.len().cmp(&right.len()).then_with(|| a.cmp(b))
}

/// Takes the run of digits at the front, without its leading zeros.
fn digits<'a>(rest: &mut &'a [u8]) -> &'a [u8] {
    let end = rest.iter().position(|byte| !byte.is_ascii_digit()).unwrap_or(rest.len());
    let (run, tail) = rest.split_at(end);
    *rest = tail;
    let zeros = run.iter().take_while(|byte| **byte == b'0').count();
    &run[zeros..]
}

/// The last run of digits in a name, as the frame number it stands for: `frame_000012` is 12.
pub fn number(name: &str) -> Option<usize> {
    let end = name.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = name[..end]
        .rfind(|c: char| !c.is_ascii_digit())
        .map_or(0, |at| at + name[at..].chars().next().map_or(1, char::len_utf8));
    name[start..end].parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn two_comes_before_ten() {
        let mut names = ["10_color.png", "9_color.png", "0_color.png", "1_color.png", "a", "frame-02", "frame-1"];
        names.sort_by(|a, b| cmp(a, b));
        assert_eq!(names, ["0_color.png", "1_color.png", "9_color.png", "10_color.png", "a", "frame-1", "frame-02"]);
    }

    #[test]
    fn numbers_are_the_last_digits() {
        assert_eq!(number("aov_image_0042"), Some(42));
        assert_eq!(number("7_color"), Some(7));
        assert_eq!(number("é12"), Some(12));
        assert_eq!(number("color"), None);
        assert_eq!(number("99999999999999999999999999"), None);
    }

    proptest! {
        #[test]
        fn the_order_is_total(a in "[a0-9é]{0,8}", b in "[a0-9é]{0,8}", c in "[a0-9é]{0,8}") {
            prop_assert_eq!(cmp(&a, &b), cmp(&b, &a).reverse());
            prop_assert_eq!(cmp(&a, &b).is_eq(), a == b);
            if cmp(&a, &b).is_le() && cmp(&b, &c).is_le() {
                prop_assert!(cmp(&a, &c).is_le());
            }
        }
    }
}

//! Sizes and times with units, as people write them: `20GiB`, `90s`.

/// A number and its unit.
fn measure(text: &str, units: &[(&str, f64)]) -> Result<f64, String> {
    let text = text.trim();
    let at = text.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(text.len());
    let (number, unit) = text.split_at(at);
    let unit = unit.trim().to_ascii_lowercase();
    let factor = units.iter().find(|(name, _)| *name == unit).map(|(_, factor)| *factor);
    match (number.parse::<f64>(), factor) {
        (Ok(number), Some(factor)) if number.is_finite() => Ok(number * factor),
        _ => {
            let names: Vec<&str> = units.iter().map(|(name, _)| *name).filter(|name| !name.is_empty()).collect();
            Err(format!("give a number and one of {}", names.join(", ")))
        }
    }
}

/// Seconds of a text such as `90s` or `30d`.
///
/// # Errors
/// In words if it is no such text.
pub fn seconds(text: &str) -> Result<f64, String> {
    measure(text, &[("s", 1.0), ("m", 60.0), ("h", 3600.0), ("d", 86_400.0)])
}

/// Bytes of a text such as `20GiB`.
///
/// # Errors
/// In words if it is no such text.
pub fn bytes(text: &str) -> Result<u64, String> {
    let k = 1024.0;
    let units = [
        ("", 1.0),
        ("b", 1.0),
        ("kb", 1e3),
        ("mb", 1e6),
        ("gb", 1e9),
        ("tb", 1e12),
        ("kib", k),
        ("mib", k * k),
        ("gib", k * k * k),
        ("tib", k * k * k * k),
    ];
    measure(text, &units).map(|bytes| bytes as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_times_have_units() {
        assert_eq!((bytes("20GiB"), bytes("1.5 mb"), bytes("7")), (Ok(20 << 30), Ok(1_500_000), Ok(7)));
        assert_eq!((seconds("90s"), seconds("30d"), seconds("1.5h")), (Ok(90.0), Ok(2_592_000.0), Ok(5400.0)));
        for bad in ["", "x", "3", "-1d", "3 weeks", "1e9d"] {
            assert!(seconds(bad).is_err(), "{bad}");
        }
        assert!(bytes("3 apples").is_err());
    }
}

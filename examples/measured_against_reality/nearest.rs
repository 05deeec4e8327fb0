//! Nearest neighbours by thumbnails.

/// A scene.
pub struct Scene<'a> {
    /// Its key.
    pub key: &'a str,
    /// Its content's signature.
    pub content: &'a str,
    /// Display luminance of its preview made small.
    pub thumbnail: &'a [f64],
}

/// Distances of scenes to the nearest of others, sorted.
pub struct Nearest {
    /// Whose, and to which.
    pub what: &'static str,
    /// Root mean square differences of display luminance.
    pub distances: Vec<f64>,
    /// The nearest two of all.
    pub closest: Option<[String; 2]>,
}

/// From each test scene to the training scenes, and within the training side to other contents and to the same.
pub fn between(train: &[Scene<'_>], test: &[Scene<'_>]) -> [Nearest; 3] {
    [
        nearest("test scene to training scene", test, train, |a, b| a.content != b.content),
        nearest("training scene to one of another content", train, train, |a, b| a.content != b.content),
        nearest("training scene to one of the same content", train, train, |a, b| {
            a.content == b.content && a.key != b.key
        }),
    ]
}

fn nearest(
    what: &'static str,
    from: &[Scene<'_>],
    to: &[Scene<'_>],
    counts: impl Fn(&Scene<'_>, &Scene<'_>) -> bool,
) -> Nearest {
    let of = |scene: &Scene<'_>| {
        let others = to.iter().filter(|other| counts(scene, other));
        let all = others.map(|other| (distance(scene.thumbnail, other.thumbnail), other.key));
        let (distance, key) = all.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((distance, [scene.key.to_owned(), key.to_owned()]))
    };
    let mut found: Vec<(f64, [String; 2])> = from.iter().filter_map(of).collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let closest = found.first().map(|(_, keys)| keys.clone());
    Nearest { what, distances: found.into_iter().map(|(distance, _)| distance).collect(), closest }
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    let squares: f64 = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum();
    (squares / a.len().max(1) as f64).sqrt()
}

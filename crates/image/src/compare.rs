//! How far two pictures are apart, as radiance and not by eye.

use crate::{ImageError, Loaded, luminance};

/// What [`difference`] found. Luminances are those of `R`, `G`, `B` in W/m²/sr.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Pixels compared.
    pub pixels: u64,
    /// Pixels whose `R`, `G`, `B` differ in any bit.
    pub differing: u64,
    /// Pixels left out because one of the pictures has no finite number there.
    pub not_finite: u64,
    /// Mean luminance of the first picture.
    pub mean_a: f64,
    /// Mean luminance of the second picture, the reference.
    pub mean_b: f64,
    /// `mean_a / mean_b - 1`: the first picture is this much brighter; 0 if both are black.
    pub bias: f64,
    /// Mean over pixels of the absolute difference of luminance, as a share of
    /// [`Difference::mean_b`]; never negative, 0 if nothing differs.
    pub mean_relative: f64,
    /// Root of the mean squared difference, over all three channels.
    pub rmse: f64,
    /// [`Difference::rmse`] as a share of [`Difference::mean_b`]; 0 if nothing differs.
    pub relative_rmse: f64,
    /// Largest absolute difference in any channel.
    pub max: f64,
    /// Where that is: column and row from the top left.
    pub max_at: [u32; 2],
}

/// Compares the radiance (`R`, `G`, `B`) of a picture with that of a reference. Fails with
/// [`ImageError::Unlike`] if the sizes differ or one has no such channels.
pub fn difference(a: &Loaded, b: &Loaded) -> Result<Difference, ImageError> {
    let unlike = |reason| ImageError::Unlike { a: a.name.clone(), b: b.name.clone(), reason };
    if (a.width, a.height) != (b.width, b.height) {
        return Err(unlike(format!(
            "the first has {} x {} pixels, the second {} x {}; render them at one size",
            a.width, a.height, b.width, b.height
        )));
    }
    let pixels = a.width as usize * a.height as usize;
    let mut planes = [[&[] as &[f32]; 3]; 2];
    for (picture, planes) in [a, b].into_iter().zip(&mut planes) {
        for (name, plane) in ["R", "G", "B"].into_iter().zip(planes) {
            *plane = picture.channel(name).filter(|p| p.len() == pixels).ok_or_else(|| {
                unlike(format!("{} has no full channel {name}; compare RGB pictures", picture.name))
            })?;
        }
    }
    let mut d = Difference {
        pixels: 0,
        differing: 0,
        not_finite: 0,
        mean_a: 0.0,
        mean_b: 0.0,
        bias: 0.0,
        mean_relative: 0.0,
        rmse: 0.0,
        relative_rmse: 0.0,
        max: 0.0,
        max_at: [0; 2],
    };
    let [[ar, ag, ab], [br, bg, bb]] = planes;
    for i in 0..pixels {
        let (pa, pb) = ([ar[i], ag[i], ab[i]], [br[i], bg[i], bb[i]]);
        d.differing += u64::from(pa.map(f32::to_bits) != pb.map(f32::to_bits));
        if !pa.iter().chain(&pb).all(|v| v.is_finite()) {
            d.not_finite += 1;
            continue;
        }
        d.pixels += 1;
        let (ya, yb) = (f64::from(luminance(pa)), f64::from(luminance(pb)));
        d.mean_a += ya;
        d.mean_b += yb;
        d.mean_relative += (ya - yb).abs();
        for (va, vb) in pa.into_iter().zip(pb) {
            let delta = (f64::from(va) - f64::from(vb)).abs();
            d.rmse += delta * delta;
            if delta > d.max {
                d.max = delta;
                d.max_at = [i as u32 % a.width, i as u32 / a.width];
            }
        }
    }
    let n = d.pixels.max(1) as f64;
    d.mean_a /= n;
    d.mean_b /= n;
    d.rmse = (d.rmse / (3.0 * n)).sqrt();
    let share = |value: f64| if value == 0.0 { 0.0 } else { value / d.mean_b };
    (d.bias, d.mean_relative) = (share(d.mean_a - d.mean_b), share(d.mean_relative / n));
    d.relative_rmse = share(d.rmse);
    Ok(d)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Picture;
    use crate::rows::tests::noise;
    use enf_layout::film::PixelRecord;

    fn flat(y: f32) -> Loaded {
        let pixels = vec![PixelRecord { direct: [y; 3], ..Default::default() }; 12];
        Loaded::from_picture(&Picture { width: 4, height: 3, pixels: &pixels })
    }

    #[test]
    fn equal_pictures_do_not_differ() {
        let pixels = noise(100);
        let a = Loaded::from_picture(&Picture { width: 10, height: 10, pixels: &pixels });
        let d = difference(&a, &a).unwrap();
        assert_eq!((d.pixels, d.differing, d.not_finite), (100, 0, 0));
        assert_eq!((d.rmse, d.max, d.mean_relative, d.relative_rmse), (0.0, 0.0, 0.0, 0.0));
        let d = difference(&flat(0.0), &flat(0.0)).unwrap();
        assert_eq!((d.mean_relative, d.relative_rmse), (0.0, 0.0));
    }

    #[test]
    fn a_known_difference_is_found() {
        let d = difference(&flat(1.5), &flat(1.0)).unwrap();
        assert!((d.mean_relative - 0.5).abs() < 1e-6 && (d.bias - 0.5).abs() < 1e-6);
        assert!((difference(&flat(0.5), &flat(1.0)).unwrap().bias + 0.5).abs() < 1e-6);
        assert!((d.rmse - 0.5).abs() < 1e-9);
        assert_eq!((d.differing, d.max), (12, 0.5));
        let mut a = flat(1.0);
        a.channels.get_mut("G").unwrap()[4 + 2] += 3.0;
        a.channels.get_mut("R").unwrap()[0] = f32::NAN;
        let d = difference(&a, &flat(1.0)).unwrap();
        assert_eq!((d.max, d.max_at), (3.0, [2, 1]));
        assert_eq!((d.pixels, d.differing, d.not_finite), (11, 2, 1));
        assert!((d.rmse - (9.0f64 / 33.0).sqrt()).abs() < 1e-9);
    }

    #[test]
    fn unlike_pictures_are_refused() {
        let pixels = noise(12);
        let other = Loaded::from_picture(&Picture { width: 3, height: 4, pixels: &pixels });
        let error = difference(&flat(1.0), &other).unwrap_err();
        assert!(error.to_string().contains("4 x 3"), "{error}");
        let mut other = flat(1.0);
        other.channels.remove("B");
        assert!(difference(&flat(1.0), &other).unwrap_err().to_string().contains("channel B"));
    }
}

//! Portable float maps: the plainest file of linear colours.

use std::path::Path;

use enf_stage::Result;
use enf_stage::failure::IoContext;

/// Writes linear colours, rows from the top.
pub(crate) fn write(path: &Path, width: u32, height: u32, texels: &[[f32; 3]]) -> Result<()> {
    let mut bytes = format!("PF\n{width} {height}\n-1.0\n").into_bytes();
    // The file begins with the bottom row.
    for row in texels.chunks_exact(width.max(1) as usize).take(height as usize).rev() {
        bytes.extend(row.iter().flatten().flat_map(|v| v.to_le_bytes()));
    }
    std::fs::write(path, bytes).at("write", path)
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_bottom_row_comes_first() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pfm");
        super::write(&path, 1, 2, &[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let (head, rest) = bytes.split_at(bytes.len() - 24);
        assert_eq!(head, b"PF\n1 2\n-1.0\n");
        let values: Vec<f32> =
            rest.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
        assert_eq!(values, [4.0, 5.0, 6.0, 1.0, 2.0, 3.0]);
    }
}

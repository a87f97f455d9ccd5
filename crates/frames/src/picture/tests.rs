//! Every kind of picture, exactly; and every kind cut short.

use super::*;
use image::{ImageBuffer, Luma, LumaA, Rgb, Rgba};
use std::path::PathBuf;

const SIZE: Size = Size::new(7, 5);

/// A picture whose every value differs, so that swapped rows or channels show.
fn ramp(x: u32, y: u32, channel: u32) -> u16 {
    (1000 * x + 7000 * y + 300 * channel + 77) as u16
}

fn saved(folder: &tempfile::TempDir, name: &str, picture: &DynamicImage) -> PathBuf {
    let path = folder.path().join(name);
    picture.save(&path).unwrap();
    path
}

fn expected(value: impl Fn(u32, u32, u32) -> u8) -> Image {
    Image::from_fn(SIZE, |x, y| [0, 1, 2].map(|channel| value(x as u32, y as u32, channel)))
}

#[test]
fn sixteen_bits_keep_their_upper_byte() {
    let folder = tempfile::tempdir().unwrap();
    let rgb = ImageBuffer::from_fn(7, 5, |x, y| Rgb([0, 1, 2].map(|c| ramp(x, y, c))));
    let rgba = ImageBuffer::from_fn(7, 5, |x, y| Rgba([0, 1, 2, 3].map(|c| ramp(x, y, c))));
    let grey = ImageBuffer::from_fn(7, 5, |x, y| Luma([ramp(x, y, 0)]));
    let grey_alpha = ImageBuffer::from_fn(7, 5, |x, y| LumaA([ramp(x, y, 0), 9]));
    let colour = expected(|x, y, c| (ramp(x, y, c) >> 8) as u8);
    let repeated = expected(|x, y, _| (ramp(x, y, 0) >> 8) as u8);
    for (name, picture, expected) in [
        ("rgb16.png", DynamicImage::ImageRgb16(rgb.clone()), &colour),
        ("rgb16.tif", DynamicImage::ImageRgb16(rgb), &colour),
        ("rgba16.png", DynamicImage::ImageRgba16(rgba), &colour),
        ("grey16.png", DynamicImage::ImageLuma16(grey.clone()), &repeated),
        ("grey16.tiff", DynamicImage::ImageLuma16(grey), &repeated),
        ("grey_alpha16.png", DynamicImage::ImageLumaA16(grey_alpha), &repeated),
    ] {
        assert_eq!(read(&saved(&folder, name, &picture)).unwrap(), *expected, "{name}");
    }
}

#[test]
fn eight_bits_stay_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let byte = |x, y, c| ramp(x, y, c) as u8;
    let rgb = DynamicImage::ImageRgb8(ImageBuffer::from_fn(7, 5, |x, y| Rgb([0, 1, 2].map(|c| byte(x, y, c)))));
    let rgba = DynamicImage::ImageRgba8(ImageBuffer::from_fn(7, 5, |x, y| Rgba([0, 1, 2, 3].map(|c| byte(x, y, c)))));
    let grey = DynamicImage::ImageLuma8(ImageBuffer::from_fn(7, 5, |x, y| Luma([byte(x, y, 0)])));
    for name in ["a.png", "a.tif", "a.bmp", "a.webp"] {
        assert_eq!(read(&saved(&folder, name, &rgb)).unwrap(), expected(byte), "{name}");
    }
    assert_eq!(read(&saved(&folder, "rgba.png", &rgba)).unwrap(), expected(byte));
    assert_eq!(read(&saved(&folder, "grey.png", &grey)).unwrap(), expected(|x, y, _| byte(x, y, 0)));
    assert_eq!(size(&folder.path().join("a.webp")).unwrap(), SIZE);
}

#[test]
fn palettes_are_looked_up() {
    /// 2x1 pixels, palette (10, 20, 30), (200, 100, 50), indices 1 and 0; 8 bits per index, stored deflate block.
    fn palette_png() -> Vec<u8> {
        use std::io::Write as _;
        let mut deflated = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::none());
        deflated.write_all(&[0, 1, 0]).unwrap();
        let mut png = b"\x89PNG\r\n\x1a\n".to_vec();
        let mut chunk = |name: &[u8; 4], data: &[u8]| {
            let body = [name.as_slice(), data].concat();
            let mut crc = flate2::Crc::new();
            crc.update(&body);
            png.extend((data.len() as u32).to_be_bytes());
            png.extend(body);
            png.extend(crc.sum().to_be_bytes());
        };
        chunk(b"IHDR", &[0, 0, 0, 2, 0, 0, 0, 1, 8, 3, 0, 0, 0]);
        chunk(b"PLTE", &[10, 20, 30, 200, 100, 50]);
        chunk(b"IDAT", &deflated.finish().unwrap());
        chunk(b"IEND", &[]);
        png
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("palette.png");
    std::fs::write(&path, palette_png()).unwrap();
    assert_eq!(read(&path).unwrap().rgb(), [200, 100, 50, 10, 20, 30]);
}

#[test]
fn jpeg_comes_close() {
    let folder = tempfile::tempdir().unwrap();
    let flat = DynamicImage::ImageRgb8(ImageBuffer::from_pixel(16, 16, Rgb([120, 60, 30])));
    let image = read(&saved(&folder, "a.jpg", &flat)).unwrap();
    assert!(image.rgb().iter().zip([120, 60, 30].iter().cycle()).all(|(a, b)| a.abs_diff(*b) <= 3));
}

#[test]
fn a_picture_cut_short_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let noise = |x: u32, y: u32| Rgb([0, 1, 2].map(|c| (x * 31 + y * 57 + c * 91 + x * y * 7) as u8));
    let picture = DynamicImage::ImageRgb8(ImageBuffer::from_fn(64, 48, noise));
    for name in ["a.png", "a.jpg", "a.tif", "a.bmp", "a.webp"] {
        let path = saved(&folder, name, &picture);
        let whole = std::fs::read(&path).unwrap();
        for share in [0, 1, 10, 50, 90, 98] {
            std::fs::write(&path, &whole[..whole.len() * share / 100]).unwrap();
            let error = read(&path).expect_err(name).to_string();
            assert!(error.contains(name) && !error.contains('\n'), "{error}");
        }
    }
}

#[test]
fn neither_missing_files_nor_text_are_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let text = folder.path().join("text.png");
    std::fs::write(&text, "not a picture").unwrap();
    assert!(read(&text).unwrap_err().to_string().contains("no readable picture"));
    assert!(matches!(read(&folder.path().join("none.png")), Err(FramesError::Missing { .. })));
    assert!(!is_picture(&text));
}

#[test]
fn an_absurd_size_is_refused_before_memory_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("huge.bmp");
    let mut header = vec![0; 54];
    header[..2].copy_from_slice(b"BM");
    header[10] = 54;
    header[14] = 40;
    header[18..22].copy_from_slice(&1_000_000_u32.to_le_bytes());
    header[22..26].copy_from_slice(&1_000_000_u32.to_le_bytes());
    (header[26], header[28]) = (1, 24);
    std::fs::write(&path, header).unwrap();
    assert!(read(&path).is_err());
}

#[test]
fn what_is_written_reads_back_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let image = expected(|x, y, c| ramp(x, y, c) as u8);
    write_png(&path, &image).unwrap();
    assert_eq!(read(&path).unwrap(), image);
    let values = Grid::from_fn(SIZE, |x, y| ramp(x as u32, y as u32, 0));
    write_gray16_png(&path, &values).unwrap();
    assert_eq!(decode(&path).unwrap().into_luma16().into_raw(), values.values());
    let mask = Grid::from_fn(SIZE, |x, y| (x + y) % 3 == 0);
    write_mask_png(&path, &mask).unwrap();
    assert_eq!(read_mask(&path).unwrap(), mask);
}

#[test]
fn a_failed_write_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("no").join("a.png");
    let error = write_png(&path, &expected(|_, _, _| 0)).unwrap_err().to_string();
    assert!(error.contains("check that its parent folder exists"), "{error}");
    assert!(!path.exists());
}

//! Writes a valid input for every target to `corpus/<target>/seed`.

use std::path::Path;

fn main() -> std::io::Result<()> {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    for parser in endoscape_fuzz::PARSERS {
        let folder = corpus.join(parser.name);
        std::fs::create_dir_all(&folder)?;
        std::fs::write(folder.join("seed"), (parser.seed)())?;
    }
    Ok(())
}

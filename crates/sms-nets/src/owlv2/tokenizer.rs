//! CLIP's byte-level byte-pair encoding of queries.

use crate::NetsError;
use sms_core::InputError;
use std::path::Path;
use tokenizers::models::bpe::BPE;
use tokenizers::normalizers::replace::ReplacePattern;
use tokenizers::normalizers::{Lowercase, NFC, Replace, Sequence as Normalizers};
use tokenizers::pre_tokenizers::byte_level::ByteLevel;
use tokenizers::pre_tokenizers::sequence::Sequence as PreTokenizers;
use tokenizers::pre_tokenizers::split::{Split, SplitPattern};
use tokenizers::{AddedToken, SplitDelimiterBehavior, Tokenizer};

const START: &str = "<|startoftext|>";
const END: &str = "<|endoftext|>";
/// Padding token of OWLv2, with id 0.
const PAD: &str = "!";
/// Regular expression of words (CLIP, `simple_tokenizer.py`).
const WORDS: &str =
    r"<\|startoftext\|>|<\|endoftext\|>|'s|'t|'re|'ve|'m|'ll|'d|[\p{L}]+|[\p{N}]|[^\s\p{L}\p{N}]+";

/// Tokenizer of queries.
#[derive(Debug)]
pub struct ClipTokenizer {
    inner: Tokenizer,
    start: u32,
    end: u32,
    pad: u32,
    length: usize,
}

/// Tokens of a query, padded to the length of the text tower.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tokens {
    /// Token ids, with start, end and padding.
    pub ids: Vec<u32>,
    /// Number of tokens without padding.
    pub used: usize,
    /// Whether the query was longer and was cut.
    pub is_cut: bool,
}

impl ClipTokenizer {
    /// Reads `vocab.json` and `merges.txt` of a model's folder; queries are padded and cut to `length` tokens.
    ///
    /// # Errors
    /// [`NetsError::Input`] if a file is missing, damaged, or of another kind of tokenizer.
    pub fn open(folder: &Path, length: usize) -> Result<Self, NetsError> {
        let (vocab, merges) = (folder.join("vocab.json"), folder.join("merges.txt"));
        let bad = |error: Box<dyn std::error::Error + Send + Sync>| {
            InputError::new(
                "the tokenizer's files cannot be used",
                folder,
                "vocab.json and merges.txt of the OWLv2 model are needed here: `sms models fetch` fetches them",
            )
            .because(error)
        };
        let (Some(vocab), Some(merges)) = (vocab.to_str(), merges.to_str()) else {
            return Err(bad("the path is not valid Unicode".into()).into());
        };
        let bpe = BPE::from_file(vocab, merges)
            .unk_token(END.into())
            .end_of_word_suffix("</w>".into())
            .continuing_subword_prefix(String::new())
            .build()
            .map_err(bad)?;
        let mut inner = Tokenizer::new(bpe);
        let blank = Replace::new(ReplacePattern::Regex(r"\s+".into()), " ").map_err(bad)?;
        let normalizers = vec![NFC.into(), blank.into(), Lowercase.into()];
        inner.with_normalizer(Some(Normalizers::new(normalizers))).map_err(bad)?;
        let words = Split::new(SplitPattern::Regex(WORDS.into()), SplitDelimiterBehavior::Removed, true);
        let bytes = ByteLevel::new(false, true, true);
        let pre = vec![words.map_err(bad)?.into(), bytes.into()];
        inner.with_pre_tokenizer(Some(PreTokenizers::new(pre)));
        let special = [PAD, START, END].map(|token| AddedToken::from(token, true));
        inner.add_special_tokens(special).map_err(bad)?;
        let id = |token: &str| {
            inner.token_to_id(token).ok_or_else(|| bad(format!("there is no token `{token}`").into()))
        };
        let (start, end, pad) = (id(START)?, id(END)?, id(PAD)?);
        Ok(Self { start, end, pad, length: length.max(2), inner })
    }

    /// Returns the tokens of one query.
    ///
    /// # Errors
    /// [`NetsError::Input`] if the text cannot be encoded.
    pub fn encode(&self, text: &str) -> Result<Tokens, NetsError> {
        let encoding = self.inner.encode(text, false).map_err(|e| {
            InputError::new(format!("the words `{text}` cannot be encoded"), "--objects", "use other words")
                .because(e)
        })?;
        let room = self.length - 2;
        let is_cut = encoding.get_ids().len() > room;
        let mut ids = vec![self.start];
        ids.extend(encoding.get_ids().iter().take(room));
        ids.push(self.end);
        let used = ids.len();
        ids.resize(self.length, self.pad);
        Ok(Tokens { ids, used, is_cut })
    }
}

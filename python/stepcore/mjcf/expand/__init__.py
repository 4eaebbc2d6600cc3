"""Elements that stand for others: `<replicate>` and `<attach>` are replaced by what they mean."""

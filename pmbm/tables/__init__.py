"""Recordings as tables, one row a box: a table is a DataFrame or a pyarrow Table here, and a CSV or
Parquet file in `pmbm.datasets.table`.

An empty cell of a column that is not needed stands for the column's default.  Rows are counted from
0.  The values themselves are made in `pmbm.types`, which this package does not know.
"""

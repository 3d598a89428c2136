"""Raw recordings as files hold them: HDF5, MATLAB, Parquet, TDMS, text, universal files, WAV."""

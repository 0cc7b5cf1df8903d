# sassgis with the extras for clusters and Parquet tables:
#
#   docker build -t sassgis .
#   docker run --rm -v "$PWD:/data" -w /data sassgis zone config.toml -o zones
#
# As a worker or scheduler of a cluster: docker run --entrypoint dask sassgis worker tcp://node:8786
FROM python:3.12-slim

# The OpenMP runtime and expat, which the wheels of numba and GDAL do not bring.
RUN apt-get update \
    && apt-get install -y --no-install-recommends libgomp1 libexpat1 \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /src
COPY . .
RUN pip install --no-cache-dir ".[cluster,parquet]" && rm -rf /src/*

# Compiled kernels: mount a volume here to keep them. With `docker run --user` name a folder that
# belongs to that user, or they are compiled at each start.
ENV SASSGIS_CACHE_DIR=/var/cache/sassgis
RUN mkdir -m 755 /var/cache/sassgis
WORKDIR /data
ENTRYPOINT ["sassgis"]
CMD ["--help"]

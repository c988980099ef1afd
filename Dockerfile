# From the wheel: `python -m build --wheel`, then
#   docker build -t kt3dmoseg .                        docker build -t kt3dmoseg-scorer --target scorer .
#   docker run -p 8000:8000 -v $PWD/data:/data kt3dmoseg        the labelling page of data/*.h5 and data/frames/CLIP/; it prints its address
# The scorer is the image of a Codabench competition: tools/make_codabench_bundle.py writes the bundle.
FROM python:3.12-slim AS scorer
COPY dist/*.whl /tmp/
RUN python -m pip install --no-cache-dir /tmp/*.whl && rm /tmp/*.whl
CMD ["mseg", "--help"]

FROM scorer AS labeller
COPY dist/*.whl /tmp/
RUN python -m pip install --no-cache-dir "$(echo /tmp/*.whl)[label]" && rm /tmp/*.whl
RUN useradd --create-home annotator
USER annotator
WORKDIR /data
EXPOSE 8000
CMD ["kt3dmoseg", "label", ".", "--host", "0.0.0.0", "--port", "8000", "--no-browser"]
